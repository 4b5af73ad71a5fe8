# SPDX-License-Identifier: Apache-2.0
"""Numbers from the Brain to the law beside the plan: through the package, and through the gateway."""

import time
from collections.abc import Iterator

import lithe
import pytest
from calm import calm_robot, connected
from lithe.errors import LitheError, Refused
from lithe.gateway import Gateway
from lithe.remote import Remote

INPUTS = """
[[input]]
name = "push_nm"
min = -0.1
max = 0.1

[[input]]
name = "phase"
min = 1.0
max = 2.0
"""
LAW = """#include <lithe/law.hpp>
struct Pushed {
  struct Params { lithe::Param kd_nm_s_rad{0.05, 0, 1}; };
  struct State {};
  struct Probes { double push_nm = 0, phase = 0, stale = 0; };
  static void step(const lithe::Tick& t, const Params& p, State&, lithe::Effort& u, Probes& probes) {
    u.torque_nm[0] = t.input[0] - p.kd_nm_s_rad * t.velocity_rad_s[0];
    probes = {t.input[0], t.input[1], (t.flags & lithe::kInputStale) != 0 ? 1.0 : 0.0};
  }
};
LITHE_LAW(Pushed, "pushed");
"""


@pytest.fixture
def robot() -> Iterator[lithe.Robot]:
    """The arm with two inputs, and a law that uses them."""
    with calm_robot(changes={"\n[[joint]]\n": INPUTS + "\n[[joint]]\n"}), connected() as robot:
        robot.swap(LAW, "pushed.cpp", probation_s=0)
        yield robot


def probes(robot: lithe.Robot) -> list[float]:
    """What the law had in the newest tick."""
    record = robot.spine.latest()
    assert record is not None
    return [float(value) for value in record["probe"][:3]]


def until(robot: lithe.Robot, wanted: list[float]) -> None:
    """The law has these within ten seconds."""
    end_s = time.monotonic() + 10
    while probes(robot) != wanted:
        assert time.monotonic() < end_s, f"{probes(robot)}, wanted {wanted}"
        time.sleep(0.001)


def test_a_law_has_what_the_brain_sends(robot: lithe.Robot) -> None:
    """All in one tick; the others stay; what is refused changes nothing; silence makes them stale."""
    until(robot, [0, 1, 1])  # of the file: 0, and the end of the range that is nearer to 0
    robot.inputs.set(push_nm=0.05, phase=1.5)
    until(robot, [0.05, 1.5, 0])
    robot.inputs["push_nm"] = -0.1
    until(robot, [-0.1, 1.5, 0])
    with pytest.raises(Refused, match=r"phase = 2\.5, allowed 1 to 2") as out:
        robot.inputs.set(push_nm=0.01, phase=2.5)
    assert out.value.code == "refused_range"
    with pytest.raises(Refused, match="no input 'fase'") as unknown:
        robot.inputs["fase"] = 1
    assert unknown.value.code == "unknown_input"
    assert "push_nm" in unknown.value.next
    with pytest.raises(LitheError):
        robot.inputs["push_nm"] = float("nan")
    assert robot.inputs.get()["push_nm"] == {"value": -0.1, "min": -0.1, "max": 0.1}
    assert robot.status()["inputs"] == {"push_nm": -0.1, "phase": 1.5}
    until(robot, [-0.1, 1.5, 1])  # stale_after_s of a calm robot is 2 s


def test_the_spine_itself_refuses_what_is_out_of_range(robot: lithe.Robot) -> None:
    """A Brain that skips the package's check: an event says which value, and the law keeps what it had."""
    robot.inputs.set(push_nm=0.02, phase=1.25)
    until(robot, [0.02, 1.25, 0])
    assert robot._writer is not None
    for _ in range(50):
        robot._writer.write_inputs([0.02, 1e300])
        time.sleep(0.001)
    assert probes(robot)[:2] == [0.02, 1.25]
    told = [each for each in robot.events()["events"] if each["kind"] == "inputs_refused"]
    assert len(told) == 1
    assert "phase" in told[0]["text"]
    assert "1.000 to 2.000" in told[0]["text"]


def test_a_client_of_the_gateway_sends_them(robot: lithe.Robot) -> None:
    """By name; described with their ranges; `history` has them."""
    gateway = Gateway(robot, token="sesame")
    gateway.start()
    with Remote("127.0.0.1", gateway.port, "sesame") as agent:
        assert agent.call("describe")["inputs"]["phase"] == {"value": 1.0, "min": 1.0, "max": 2.0}
        assert agent.call("set_inputs", values={"push_nm": 0.03}) == {"sent": {"push_nm": 0.03}}
        until(robot, [0.03, 1, 0])
        assert agent.call("latest", fields=["input"])["input"] == [0.03, 1.0]
        with pytest.raises(Refused, match=r"allowed -0\.1 to 0\.1"):
            agent.call("set_inputs", values={"push_nm": 3})
    gateway.close()
