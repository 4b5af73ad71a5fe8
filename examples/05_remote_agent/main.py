# SPDX-License-Identifier: Apache-2.0
"""Open the gateway, and drive the robot through it as an agent on another machine would: JSON lines over TCP."""

import tempfile
import time
from pathlib import Path

import lithe
from lithe.gateway import Gateway, write_token
from lithe.remote import Remote

with lithe.connect() as robot, tempfile.TemporaryDirectory() as folder:
    gateway = Gateway(robot, token=write_token(Path(folder) / "token"))
    gateway.start()

    agent = Remote("127.0.0.1", gateway.port, gateway.token)  # all an agent needs
    about = agent.call("describe")
    print("joints:", [joint["name"] for joint in about["joints"]], "at", about["rate_hz"], "Hz")

    agent.call("swap", source=Path("laws/gravity_pd.cpp").read_text(), name="gravity_pd.cpp", params={"mgl_nm": 0.165})
    print("law:", agent.call("status")["law"])

    agent.call("publish", t_ns=[time.monotonic_ns() + 300_000_000], position_rad=[[0.3]], streaming=False)
    time.sleep(1.0)
    history = agent.call("history", seconds=0.5, fields=["position_rad"])
    print("arrived near 0.3 rad:", abs(history["position_rad"][-1][0] - 0.3) < 0.05)

    try:
        Remote("127.0.0.1", gateway.port, "not the token")
    except lithe.Refused as error:
        print("without the token:", error.code)
    agent.close()
    gateway.close()
