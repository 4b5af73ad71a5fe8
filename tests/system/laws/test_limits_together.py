# SPDX-License-Identifier: Apache-2.0
"""Laws that turn bad when they are confirmed, on running robots whose joints push each other: no limit is passed."""

from collections.abc import Callable
from pathlib import Path

import calm
import numpy as np
import pytest
from lithe.shm import RingCursor
from system.robot_rig import ROOT, RobotRig
from system.simulated import running

GOOD_TICKS, BAD_TICKS = 3000, 4000
LAW = """#include <lithe/law.hpp>
struct Late {{
  struct Params {{}};
  struct State {{
    std::uint32_t steps = 0;
  }};
  static void step(const lithe::Tick& t, const Params&, State& s, lithe::Effort& u) {{
    constexpr double kp[] = {{{kp}}}, kd[] = {{{kd}}};
    ++s.steps;
    for (std::uint32_t j = 0; j < t.joints; ++j) {{
      const double pd = kp[j] * (t.setpoint_position_rad[j] - t.position_rad[j]) - kd[j] * t.velocity_rad_s[j];
      u.torque_nm[j] = s.steps < {good} ? pd : {bad};
    }}
  }}
}};
LITHE_LAW(Late, "late");
"""
BAD = {
    "full torque": "1e4",
    "back and forth": "(s.steps / 300 + j) % 2 ? 1e4 : -1e4",
    "the other sign": "-5 * pd + 0.2 * kp[j]",
    "pumps": "t.velocity_rad_s[j] >= 0 ? 1e4 : -1e4",
}
GAINS = {
    "chain": ("4, 4, 4", "0.1, 0.1, 0.1"),
    "arm6": ("300, 300, 150, 40, 40, 15", "20, 20, 8, 2, 2, 0.6"),
}


def robot_file(name: str, law: Path) -> str:
    """Patient with a busy machine, with a law to start with, and with a watch that takes no law away."""
    if name == "chain":
        text = calm.calm_text(robot="chain")
    else:
        folder = ROOT / "tests/limits"
        text = (folder / f"{name}.toml").read_text().replace("../../laws", "../laws")
        # A simulated moteus has a motor of 1.65 N m: the gears make of it what the file declares.
        model = {f'name = "{name}"': 'name = "arm"', f'"{name}.xml"': f'"{folder}/{name}.xml"', "= 6.0": "= 36.0"}
        text = calm.changed(text, {**calm.OTHERS, **model}, name)
    text = calm.changed(text, {f"{ROOT}/laws/pd.cpp": str(law)}, name)
    return text + '\n[swap]\nwatch = "alarm"\n'


def leads_back(rig: RobotRig) -> bool:
    """By verbs alone, whatever it is."""
    if rig.ask("status")["mode"] == "active":
        return True
    for verb in ("recover", "reset", "arm"):
        rig.lithe(verb, *(["--all-the-same"] if verb == "arm" else []))
    mode: str = rig.ask("status")["mode"]
    return mode == "active"


@pytest.mark.alone  # a Spine that is held up for ten ticks cannot brake meanwhile
@pytest.mark.parametrize("bad", BAD)
@pytest.mark.parametrize("name", GAINS)
def test_no_limit_is_passed(
    name: str, bad: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tell: Callable[[str], None]
) -> None:
    kp, kd = GAINS[name]
    good = tmp_path / "good.cpp"
    good.write_text(LAW.format(kp=kp, kd=kd, good="1e9", bad="0"))
    with running(robot_file(name, good), monkeypatch, excuse="apt-get install libmujoco-dev") as (rig, robot):
        joints = robot.spine.joint_count
        cursor = RingCursor(robot.spine.mapping, "telemetry")
        text = LAW.format(kp=kp, kd=kd, good=GOOD_TICKS, bad=BAD[bad])
        done = robot.swap(text, name="late.cpp", probation_s=0, error_ratio=0)
        records = []

        def is_over() -> bool:
            if len(new := cursor.drain()):
                records.append(new)
            return bool(len(new)) and int(new["tick"][-1]) > done["commit_tick"] + GOOD_TICKS + BAD_TICKS

        rig.wait_for(is_over)
        low, high = (np.array(robot.spine.info[f"position_{end}_rad"][:joints]) for end in ("min", "max"))
        status = rig.ask("status")
        back = leads_back(rig)
    seen = np.concatenate(records)
    position = seen["position_rad"][:, :joints]
    beyond = float(np.maximum(position - high, low - position).max())
    moved = float((position[seen["tick"] > done["commit_tick"] + GOOD_TICKS].max(axis=0) - position[0]).max())
    ended = f"{status['mode']} {status['fault']}"
    tell(f"{name}, {bad}: {beyond:.4f} rad beyond a limit, moved by {moved:.1f} rad, mode {ended}")
    assert moved > 0.5, "it did push"
    assert beyond <= 0
    assert back
