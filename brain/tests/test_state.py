# SPDX-License-Identifier: Apache-2.0
"""The running law's State, as a Brain reads it."""

import threading
import time

import lithe
import numpy as np
import pytest
from lithe._wire import StateKind
from lithe.remote import Remote
from lithe.shm import SpineView
from lithe.values import NUMBERS
from segments import Writer, own_prefix, remove
from system.robot_rig import ROOT, RobotRig

LAWS = ROOT / "laws"
KINDS = [kind for kind in StateKind if kind != StateKind.none]

PD_THAT_REMEMBERS = """
#include <lithe/law.hpp>
struct Remembers {
  struct Params {
    lithe::Param kp_nm_rad{4.0, 0.0, 200.0};
    lithe::Param kd_nm_s_rad{0.1, 0.0, 20.0};
  };
  struct State {
    std::uint32_t steps = 0;
    bool moved = false;
    float share = 0.25F;
    std::array<double, 3> kept{0.5, 1.5, 2.5};
    std::int64_t last_ns = 0;
  };
  static void step(const lithe::Tick& t, const Params& p, State& s, lithe::Effort& u) {
    ++s.steps;
    s.last_ns = t.t_ns;
    for (std::uint32_t j = 0; j < t.joints; ++j) {
      u.torque_nm[j] = p.kp_nm_rad * (t.setpoint_position_rad[j] - t.position_rad[j]) +
                       p.kd_nm_s_rad * (t.setpoint_velocity_rad_s[j] - t.velocity_rad_s[j]);
    }
  }
};
LITHE_LAW(Remembers, "remembers");
"""


def test_the_state_of_the_running_law_is_read_by_name_and_grows(robot: lithe.Robot, remote: Remote) -> None:
    robot.swap(PD_THAT_REMEMBERS, name="remembers.cpp")
    RobotRig.wait_for(lambda: robot.state().get("steps", 0) > 0)
    first = robot.state()
    assert list(first) == ["steps", "moved", "share", "kept", "last_ns"]
    assert (first["moved"], first["share"]) == (False, 0.25)
    assert first["kept"].tolist() == [0.5, 1.5, 2.5]
    assert 0 < first["last_ns"] <= time.monotonic_ns()
    RobotRig.wait_for(lambda: robot.state()["steps"] > first["steps"])
    assert remote.call("state")["kept"] == [0.5, 1.5, 2.5], "over TCP, too"


def test_the_state_follows_a_swap_and_a_rollback(robot: lithe.Robot) -> None:
    robot.swap(LAWS / "hold.cpp")
    RobotRig.wait_for(lambda: "holding" in robot.state())
    assert robot.state()["hold_position_rad"].shape == (32,)
    robot.swap(LAWS / "pd.cpp")
    RobotRig.wait_for(lambda: robot.state() == {})
    robot.rollback()
    RobotRig.wait_for(lambda: "holding" in robot.state())


def test_a_robot_that_has_ended_is_told(robot: lithe.Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robot.spine.mapping, "is_current", lambda: False)
    with pytest.raises(lithe.NotRunning, match=r"robot\.reconnect\(\)"):
        robot.state()


# ---- against segments without a Spine


@pytest.fixture
def spine(monkeypatch: pytest.MonkeyPatch) -> Writer:
    monkeypatch.setenv("LITHE_SHM_PREFIX", own_prefix())
    writer = Writer("arm", "spine")
    writer.channel("robot_info", joint_count=1, rate_hz=1000.0, robot="arm")
    return writer


def describe(spine: Writer, law_id: int, fields: list[tuple[str, StateKind, int, int]]) -> None:
    """A law whose State has these (name, kind, offset, elements)."""
    at = {"state_name": 0, "state_kind": 1, "state_offset": 2, "state_elements": 3}
    columns = {name: [field[i] for field in fields] + [0] * (32 - len(fields)) for name, i in at.items() if i > 0}
    names = [field[0] for field in fields] + [""] * (32 - len(fields))
    spine.channel("law_info", 2, law_id=law_id, state_field_count=len(fields), state_name=names, **columns)


def publish(spine: Writer, law_id: int, data: bytes) -> None:
    padded = np.frombuffer(data.ljust(4096, b"\xff"), np.uint8)
    spine.channel("law_state", law_id=law_id, state_bytes=len(data), tick=7, bytes=padded)


@pytest.mark.parametrize("kind", KINDS, ids=[kind.name for kind in KINDS])
def test_every_type_is_read_as_it_was_written(spine: Writer, kind: StateKind) -> None:
    values = np.array([1, 0, 1]).astype(NUMBERS[kind])
    describe(spine, 5, [("one", kind, 0, 1), ("three", kind, 16, 3)])
    publish(spine, 5, values[:1].tobytes().ljust(16, b"\0") + values.tobytes())
    state = SpineView("arm").state()
    assert state["one"] == 1 and type(state["one"]) in (bool, int, float)
    assert state["three"].dtype == np.dtype(NUMBERS[kind])
    assert state["three"].tolist() == values.tolist()
    remove("arm")


def test_a_state_whose_law_has_gone_is_not_guessed(spine: Writer) -> None:
    with pytest.raises(lithe.ShmError, match="no law of robot 'arm'"):
        SpineView("arm").state()
    describe(spine, 5, [("one", StateKind.f64, 0, 1)])
    publish(spine, 6, b"\0" * 8)
    with pytest.raises(lithe.ShmError, match="no law of robot 'arm'"):
        SpineView("arm").state()
    remove("arm")


def test_a_state_that_is_there_before_its_law_is_described_is_waited_for(spine: Writer) -> None:
    publish(spine, 5, b"\0" * 8)
    later = threading.Timer(0.05, describe, (spine, 5, [("one", StateKind.f64, 0, 1)]))
    later.start()
    assert SpineView("arm").state() == {"one": 0.0}
    later.join()
    remove("arm")


def test_a_state_shorter_than_its_description_is_an_error_of_ours(spine: Writer) -> None:
    describe(spine, 5, [("one", StateKind.f64, 4095, 1)])
    publish(spine, 5, b"\0" * 8)
    with pytest.raises(lithe.ShmError, match="'one' lies outside"):
        SpineView("arm").state()
    remove("arm")
