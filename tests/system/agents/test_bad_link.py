# SPDX-License-Identifier: Apache-2.0
"""`lithe agent` over a connection that takes up to 2 s each way and breaks at the worst moments. What the robot did
meanwhile is read from its telemetry, and what reached it from its certificates."""

import contextlib
import json
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import lithe
import numpy as np
import pytest
from calm import calm_robot, connected
from lithe._wire import Mode
from lithe.demo.recorder import joint_columns
from lithe.gateway import Gateway
from lithe.heartbeat import Repeat
from lithe.remote import Remote
from lithe.shm import SpineView
from model_server import ModelServer, fenced, law
from slow_link import SlowLink
from system.robot_rig import RobotRig

pytestmark = pytest.mark.early

FIELDS = (
    "release_ns",
    "release_jitter_ns",
    "mode",
    "law_id",
    "setpoint_position_rad",
    "setpoint_velocity_rad_s",
    "command_torque_nm",
)


def pd(kp: float, kd: float, name: str) -> str:
    return law(f"u.torque_nm[j] = 0.165 * std::sin(t.position_rad[j]) + {kp} * e + {kd} * de;", name)


WEAK = law("u.torque_nm[j] = 0.05 * e + 0.004 * de;", "weak")
# One law that is better than the one at the start, one that is worse, one that never arrives, and the best.
SCRIPT = [pd(1.0, 0.05, "better"), pd(0.5, 0.03, "worse"), pd(1.5, 0.05, "lost"), pd(6.0, 0.15, "best")]
CUTS = {
    ("", 3): "request", ("lease", 1): "waiting", ("set_reference", 1): "answer", ("reference", 2): "request",
    ("history", 2): "waiting", ("history", 5): "answer", ("history", 7): "ghost", ("status", 4): "answer",
    ("swap", 1): "waiting", ("swap", 3): "request", ("swap", 4): "answer", ("activate", 1): "waiting",
}  # fmt: skip


class Watch:
    """What the robot does, tick by tick, and who has the lease, until the end of `with`."""

    def __init__(self, gateway: Gateway) -> None:
        self._cursor, self._pieces = SpineView("arm").telemetry(), list[dict[str, Any]]()
        self._other, self.holders = Remote("127.0.0.1", gateway.port, "sesame"), list[str | None]()
        self._looks = [Repeat(self._look, 0.1), Repeat(self._ask, 0.3)]

    def _look(self) -> None:
        records = self._cursor.drain()
        if len(records):
            columns = joint_columns(records)
            self._pieces.append({name: columns[name].copy() for name in FIELDS})

    def _ask(self) -> None:
        self.holders.append(self._other.call("lease")["holder"])

    def __enter__(self) -> "Watch":
        return self

    def __exit__(self, *_: object) -> None:
        for each in self._looks:
            each.stop()
        self._look()
        self._other.close()
        self.seen = {name: np.concatenate([each[name] for each in self._pieces]) for name in FIELDS}

    def check(self, robot: lithe.Robot, tell: Callable[[str], None]) -> None:
        """In `active` all the time; setpoint and torque without a jump."""
        seen, info = self.seen, robot.spine.info
        assert set(seen["mode"]) == {int(Mode.active)}
        # The setpoint is that of the wake-up, which a busy machine delays.
        steps = np.diff(seen["release_ns"].astype(np.int64) + seen["release_jitter_ns"]) * 1e-9
        speed = np.abs(np.diff(seen["setpoint_position_rad"][:, 0])) / steps
        bend = np.abs(np.diff(seen["setpoint_velocity_rad_s"][:, 0])) / steps
        slew = np.abs(np.diff(seen["command_torque_nm"][:, 0])) / (np.diff(seen["release_ns"].astype(np.int64)) * 1e-9)
        # How far a tick's way is from what its speeds make: a jump, however small.
        way = np.abs(
            np.diff(seen["setpoint_position_rad"][:, 0])
            - steps * (seen["setpoint_velocity_rad_s"][1:, 0] + seen["setpoint_velocity_rad_s"][:-1, 0]) / 2
        )
        tell(f"{len(steps)} ticks: setpoint at most {1e3 * way.max():.3f} mrad off its speed, {speed.max():.2f} rad/s")
        tell(f"setpoint at most {bend.max():.0f} rad/s2, torque {slew.max():.0f} N m/s")
        assert speed.max() < float(info["velocity_max_rad_s"][0])
        assert slew.max() < 1.001 * float(info["torque_slew_nm_s"][0])
        assert bend.max() < FASTEST_RAD_S2
        # Between two wake-ups the speed may bend; the longer they are apart, the more that is on the way.
        assert (way < JUMP_RAD + FASTEST_RAD_S2 * steps**2 / 8).all()

    def at_rest(self, seconds: float = 1.0) -> bool:
        """Whether the setpoint rests in the last ticks."""
        last = self.seen["setpoint_position_rad"][-int(seconds * 1000) :, 0]
        return float(np.ptp(last)) < 1e-9


FASTEST_RAD_S2 = 100.0  # the sine and coming to rest within half a second make 20 to 40
JUMP_RAD = 0.0005


@contextlib.contextmanager
def robot_behind(
    seed: int, cuts: dict[tuple[str, int], str]
) -> Iterator[tuple[RobotRig, lithe.Robot, Gateway, SlowLink]]:
    """An arm with a bad law, its gateway, and a bad connection to that."""
    with calm_robot() as rig, connected() as robot:
        robot.swap(WEAK, name="weak.cpp", probation_s=0.0)
        gateway = Gateway(robot, token="sesame")
        gateway.start()
        try:
            with SlowLink(gateway.port, seed, cuts) as link:
                yield rig, robot, gateway, link
        finally:
            gateway.close()


def agent(rig: RobotRig, link: SlowLink, url: str, out: Path, *words: str) -> subprocess.CompletedProcess[str]:
    (out.parent / "token").write_text("sesame")
    command = [
        "--url", url, "--model", "coder", "--api", "openai", "--token-file", out.parent / "token", "--connect",
        f"127.0.0.1:{link.port}", "--goal", "track 1 Hz with the least error", "--window", "1", "--amplitude", "1",
        "--out", out, *words,
    ]  # fmt: skip
    return subprocess.run(
        [sys.executable, "-m", "lithe.agent", *map(str, command)],
        check=False, env=rig.env, capture_output=True, text=True, timeout=300,
    )  # fmt: skip


def certificates(robot: lithe.Robot) -> list[str]:
    """The names of all swaps that reached the robot."""
    folder = Path(robot.call("status")["records"])
    return [str(json.loads(path.read_text())["source"]) for path in sorted(folder.glob("[0-9]*.json"))]


@pytest.mark.long
def test_the_best_law_runs_in_the_end_and_no_swap_is_sent_twice(tmp_path: Path, tell: Callable[[str], None]) -> None:
    with (
        robot_behind(7, CUTS) as (rig, robot, gateway, link),
        ModelServer([fenced(one) for one in SCRIPT]) as server,
    ):
        with Watch(gateway) as watch:
            began_s = time.monotonic()
            done = agent(rig, link, server.url, tmp_path / "out", "--rounds", str(len(SCRIPT)))
            took_s = time.monotonic() - began_s
            time.sleep(1.5)  # it comes to rest
        print(done.stdout[-8000:], done.stderr, link.cut)
        status, arrived = robot.call("status"), Counter(certificates(robot))
        watch.check(robot, tell)
    assert done.returncode == 0, done.stdout + done.stderr
    assert status["law"] == "best"
    sent = Counter(args["name"] for verb, args in link.asked if verb == "swap")
    assert max(sent.values()) == 1 and max(arrived.values()) == 1, (sent, arrived)
    assert set(arrived) - {"weak.cpp", "pd.cpp"} == set(sent) - {"agent_003.cpp"}, "the third was cut off on its way"
    assert {kind for _, _, kind in link.cut} == {"request", "waiting", "answer", "ghost"} and len(link.cut) >= 10, (
        link.cut
    )
    assert max(link.delays_s) == 2.0
    tell(f"{len(link.asked)} requests, {len(link.cut)} cuts, {np.mean(link.delays_s):.2f} s mean delay, {took_s:.0f} s")
    held = [holder is not None for holder in watch.holders]
    assert all(held[held.index(True) :]), "its lease was free for others while it was away"
    assert watch.at_rest(0.2)


def test_an_agent_that_is_cut_off_for_good_says_so_and_the_robot_rests(
    tmp_path: Path, tell: Callable[[str], None]
) -> None:
    with (
        robot_behind(3, {("history", 2): "for_good"}) as (rig, robot, gateway, link),
        ModelServer([fenced(SCRIPT[0])]) as server,
    ):
        with Watch(gateway) as watch:
            done = agent(rig, link, server.url, tmp_path / "out", "--rounds", "4", "--reconnect", "3")
            time.sleep(1.5)
        watch.check(robot, tell)
        with Remote("127.0.0.1", gateway.port, "sesame") as other:
            assert not other.call("reference")["streams"]
            RobotRig.wait_for(lambda: other.call("lease")["holder"] is None, 30)
    assert done.returncode == 3, done.stdout + done.stderr
    assert "cannot be reached for 3 s" in done.stderr
    assert np.ptp(watch.seen["setpoint_position_rad"]) > 0.1, "it did move"
    assert watch.at_rest()


def test_a_reference_ends_at_rest_when_its_client_is_silent_and_goes_on_when_only_a_connection_broke(
    tell: Callable[[str], None],
) -> None:
    with robot_behind(5, {("reference", 2): "ghost"}) as (_, robot, gateway, link):
        sine = {"kind": "sine", "centre_rad": 0.0, "amplitude_rad": 0.3, "frequency_hz": 1.0}
        with Watch(gateway) as watch, Remote("127.0.0.1", link.port, "sesame") as client:
            since_ns = client.call("set_reference", **sine, client_stale_s=4.0)["since_ns"]
            client.call("reference")
            with pytest.raises(lithe.NotRunning):
                client.call("reference")
            for _ in range(4):
                told = client.call("reference")
                assert told["since_ns"] == since_ns and told["asked"]["kind"] == "sine"
                time.sleep(1.0)
            link.silent = True
            RobotRig.wait_for(lambda: not gateway.references.told()["streams"], 30)
            time.sleep(0.5)
        assert "silent" in gateway.references.told()["ended"]
        watch.check(robot, tell)
    assert watch.at_rest(0.4)
