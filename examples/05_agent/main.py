# SPDX-License-Identifier: Apache-2.0
"""An agent on a TCP connection: its first law has an error; it reads the compiler's message and corrects the law.

Here gateway and agent share a process to keep the example short; `python -m lithe.gateway` opens the robot to agents
in other processes or on other machines (ssh -L 7423:localhost:7423 is a good way to reach it).

In another shell:  lithe run robots/arm.toml
Then:              .venv/bin/python examples/05_agent/main.py
"""

import sys

import lithe
from lithe.gateway import Gateway
from lithe.remote import Remote

DRAFT = """
#include <lithe/law.hpp>
struct Damp {
  struct Params { lithe::Param kd_nm_s_rad{0.05, 0.0, 1.0}; };
  struct State {};
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u) {
    u.torque_nm[0] = -p.kd_nm_s_rad * t.velocity[0];
  }
};
LITHE_LAW(Damp, "damp");
"""


def agent(remote: Remote) -> None:
    about = remote.call("describe")
    print(f"robot {about['robot']} with joint {about['joints'][0]['name']} at {about['rate_hz']:.0f} Hz")
    try:
        remote.call("swap", source=DRAFT, name="damp.cpp")
    except lithe.Refused as refusal:
        first = refusal.detail["diagnostics"][0]
        print(f"refused at {first['file']}:{first['line']}; {remote.call('status')['law']} runs on")
    swap = remote.call("swap", source=DRAFT.replace("t.velocity[0]", "t.velocity_rad_s[0]"), name="damp.cpp")
    print(f"law '{swap['law']}' runs")
    recent = remote.call("history", seconds=0.5, fields=["tick", "law_id"])
    print(f"telemetry shows it: {recent['law_id'][-1] == swap['law_id']}")


try:
    with lithe.connect() as robot:
        gateway = Gateway(robot, token="a secret")
        gateway.start()
        robot.call("swap", source=DRAFT.replace("t.velocity[0]", "0.0"), name="rest.cpp", error_ratio=0)
        remote = Remote("127.0.0.1", gateway.port, "a secret")
        agent(remote)
        remote.close()
        gateway.close()
except lithe.LitheError as error:
    sys.exit(str(error))  # what is wrong, where, and the next step
