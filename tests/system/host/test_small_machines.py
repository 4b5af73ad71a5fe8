# SPDX-License-Identifier: Apache-2.0
"""Where LITHE has least: an ordinary user without any privilege, on two cores."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import calm
import pytest
from system.robot_rig import BIN, ROOT, RobotRig, need

NOBODY = 65534


def nobody(capability: str = "") -> tuple[str, ...]:
    """What to put before a command that root wants done by an ordinary user, who keeps one capability at most."""
    capabilities = f"-all,+{capability}" if capability else "-all"
    return (
        "setpriv", f"--reuid={NOBODY}", f"--regid={NOBODY}", "--clear-groups", "--no-new-privs",
        *(f"--{which}={capabilities}" for which in ("inh-caps", "ambient-caps", "bounding-set")),
    )  # fmt: skip


@pytest.fixture
def home() -> Iterator[Path]:
    """A home of the user's own: pytest's directories are closed to others."""
    folder = Path(tempfile.mkdtemp(prefix="lithe-"))
    folder.chmod(0o755)
    (folder / "arm.toml").write_text(calm.calm_text(ideal=False), encoding="utf-8")
    if os.geteuid() == 0:
        os.chown(folder, NOBODY, NOBODY)
    yield folder
    shutil.rmtree(folder, ignore_errors=True)


def as_ordinary_user() -> tuple[str, ...]:
    """What to put before a command; nothing when we are one already.

    Where the tree or Python lies in a place that only root may enter, the user gets the right to read, which neither
    clocks nor schedulers nor memory locks ask for.
    """
    if os.geteuid() != 0:
        return ()
    needed = (os.path.realpath(sys.executable), BIN / "lithe", ROOT / "brain/lithe/__init__.py")
    for way in (nobody(), nobody("dac_read_search")):
        if subprocess.run([*way, "head", "-qc1", *needed], check=False, capture_output=True).returncode == 0:
            return way
    pytest.skip(f"root here may not become an ordinary user who reads {', '.join(map(str, needed))}")


def test_tuning_without_root_cannot_begin() -> None:
    command = [*as_ordinary_user(), BIN / "lithe", "--json", "tune", "apply"]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    error = json.loads(done.stdout)["error"]
    assert (done.returncode, error["code"], error["next"]) == (2, "no_tune", "sudo lithe tune apply")


def test_a_robot_of_an_ordinary_user_runs_and_swaps() -> None:
    """It ticks on its two cores, replaces its law, and says what this machine cannot give to such a user."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    with RobotRig() as rig:
        rig.config = rig.dir / "arm.toml"
        rig.config.write_text(calm.calm_text(), encoding="utf-8")
        if os.geteuid() == 0:
            os.chown(rig.dir, NOBODY, NOBODY)
        rig.wrapper = ["taskset", "-c", ",".join(map(str, cores)), *as_ordinary_user()]
        rig.env |= {"HOME": str(rig.dir)}
        rig.run()
        rig.wait_for(lambda: rig.ask("status")["mode"] == "active")
        rig.ask("swap", ROOT / "laws/gravity_pd.cpp")
        status = rig.ask("status")
        assert (status["mode"], status["law"]) == ("active", "gravity_pd")
        assert status["lost"], "it says what such a user cannot have"
        assert status["cpus"]["spine"] in cores


@pytest.mark.alone
@pytest.mark.long
def test_the_demo_works_as_an_ordinary_user_on_two_cores(home: Path, tell: Callable[[str], None]) -> None:
    """It holds, says what it lost, and keeps to its cores."""
    need("lithe", "lithe-spine", "lithe-spine-sim", "lawd")
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        pytest.skip("this machine has one core")
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("XDG_", "LITHE_", "MPL"))}
    command = [sys.executable, "-m", "lithe.demo", "--robot", home / "arm.toml", "--out", home / "out"]
    done = subprocess.run(
        ["taskset", "-c", ",".join(map(str, cores)), *as_ordinary_user(), *command],
        env=kept | {"HOME": str(home), "PYTHONPATH": str(ROOT / "brain"), "LITHE_BIN_DIR": str(BIN)},
        cwd=home,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert "verdict" in done.stdout, done.stdout + done.stderr
    summary = json.loads((home / "out/summary.json").read_text())
    machine = summary["machine"]
    tell(f"{machine['cores']} cores, {machine['privileges']}; {machine['transport']}; lost: {machine['lost']}")
    tell(f"{summary['lost_ticks']} of {summary['ticks']} ticks lost, verdict {summary['verdict']}")
    assert done.returncode == {"holds": 0, "falls_short": 1, "INCONCLUSIVE": 4}[summary["verdict"]], done.stdout
    assert calm.falls_short(summary) == [], done.stdout
    assert (machine["cores"], machine["privileges"]) == (2, "ordinary user")
    assert machine["spine_cpu"] in cores
    assert machine["lost"] and machine["lost"] in done.stdout, "it says what this machine cannot give"
