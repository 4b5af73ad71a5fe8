# SPDX-License-Identifier: Apache-2.0
"""A machine that boots is busy: what `lithe run` does when its first law gets no processor time."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from system.robot_rig import RobotRig

# A good law whose trial takes a tenth of a second: its step takes some 10 us.
LAW = """
#include <lithe/law.hpp>
struct Slow {
  struct Params {};
  struct State {};
  static void step(const lithe::Tick& in, const Params&, State&, lithe::Effort& out) {
    double pull = in.position_rad[0];
    for (int i = 0; i < 5000; ++i) pull += 1e-4 * (in.position_rad[0] - pull);
    out.torque_nm[0] = -0.5 * pull - 0.02 * in.velocity_rad_s[0];
  }
};
LITHE_LAW(Slow, "slow");
"""
LOAD_S = 60  # at most: it ends with the test
BUSY = f"""
import os, sys, time
os.sched_setaffinity(0, [int(sys.argv[1])])
print(flush=True)
end = time.monotonic() + {LOAD_S}
while time.monotonic() < end: pass
"""


def child(parent: int, name: str) -> int:
    """The process of this name that this one has started; 0 if there is none."""
    for pid in Path(f"/proc/{parent}/task/{parent}/children").read_text().split():
        if name in Path(f"/proc/{pid}/comm").read_text():
            return int(pid)
    return 0


def yield_to_all(pid: int) -> None:
    """From here on this process and its children get what others leave, also as a session of their own."""
    os.sched_setscheduler(pid, os.SCHED_IDLE, os.sched_param(0))
    with contextlib.suppress(FileNotFoundError):  # a kernel without groups for sessions
        Path(f"/proc/{pid}/autogroup").write_text("19")


@pytest.mark.alone
def test_a_first_law_without_processor_time_is_tried_again(rig: RobotRig) -> None:
    """The load begins right before the trial of the law, and ends when `lithe run` says that it tries again."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    load = [subprocess.Popen([sys.executable, "-IS", "-c", BUSY, str(core)], stdout=subprocess.PIPE) for core in cores]
    try:
        for each in load:
            assert each.stdout is not None and each.stdout.readline()  # it runs
            each.send_signal(signal.SIGSTOP)
        rig.wrapper = ["taskset", "-c", ",".join(map(str, cores))]
        (rig.dir / "slow.cpp").write_text(LAW)
        process = rig.run("--law", str(rig.dir / "slow.cpp"), wait=False)
        rig.wait_for(lambda: child(process.pid, "lithe-spine") != 0)
        yield_to_all(child(process.pid, "lithe-trial"))
        while "swap_placed" not in rig.log():
            assert process.poll() is None, rig.log()
            time.sleep(0.002)
        for each in load:
            each.send_signal(signal.SIGCONT)
        rig.wait_for(lambda: "once more (2 of 5)" in rig.log() or process.poll() is not None or rig.socket.exists())
    finally:
        for each in load:
            each.kill()
            each.communicate()
    rig.wait_for(lambda: process.poll() is not None or rig.socket.exists())
    assert process.poll() is None, rig.log()
    assert "once more (2 of 5)" in rig.log(), rig.log()
    assert rig.ask("status")["mode"] == "active"
