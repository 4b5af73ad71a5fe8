# SPDX-License-Identifier: Apache-2.0
"""Nobody reads through the robot what he may not read himself."""

import json
import os
import subprocess
import sys
from pathlib import Path

from system.cli.connections import both_connections
from system.robot_rig import ROOT, RobotRig

LAW = ROOT / "laws" / "hold.cpp"
SECRET = "open_sesame_4711"


def everything_left(rig: RobotRig) -> list[Path]:
    """Run directory, certificates and cache; not what the test itself has put there."""
    places = [rig.dir / "run", rig.dir / "out", rig.dir / "cache"]
    return [*places, *(path for place in places for path in place.rglob("*"))]


def test_no_path_is_opened_for_a_client(rig: RobotRig) -> None:
    """A file that only the supervisor may read is quoted nowhere: not in the answer, a certificate, an event, a log."""
    secret = rig.dir / "secret.txt"
    secret.write_text(f"{SECRET} is the word\n")
    rig.run()
    with both_connections(rig) as connections:
        for connection in connections:
            for verb in ("swap", "law_check"):
                for path in (str(secret), str(LAW), "/proc/self/mem", str(rig.dir), "/dev/zero", "", 7):
                    for more in ({}, {"source": LAW.read_text()}):
                        answer = connection.ask(verb, path=path, **more)
                        assert SECRET not in json.dumps(answer)
                        assert answer["error"]["code"] == "usage" and "source" in answer["error"]["next"], answer
    assert SECRET not in rig.log()
    assert not any(SECRET in path.read_text(errors="replace") for path in everything_left(rig) if path.is_file())


def test_what_a_robot_leaves_is_not_for_every_user(rig: RobotRig) -> None:
    """Files 0640, folders 0750 at most, whatever the user's umask; sockets are for the group."""
    rig.env["LITHE_CACHE_DIR"] = str(rig.dir / "cache")
    rig.wrapper = ["sh", "-c", 'umask 0000; exec "$@"', "sh"]
    rig.run()
    assert rig.ask("swap", LAW)["verdict"] == "committed"
    rig.lithe("swap", ROOT / "tests/laws_hostile/nan_always.cpp")
    left = everything_left(rig)
    assert len(left) > 10, left
    open_to_others = [f"{path} {os.stat(path).st_mode & 0o777:o}" for path in left if os.stat(path).st_mode & 0o027]
    sockets = [path for path in left if path.is_socket()]
    assert open_to_others == [f"{path} 660" for path in sockets]


def test_a_run_folder_that_others_can_fill_is_not_used(rig: RobotRig) -> None:
    """Open to everybody, or another user's: refused before anything is made there, for Python too."""
    run = rig.dir / "run"
    run.mkdir()
    run.chmod(0o777)
    victim = rig.dir / "victim"
    victim.write_text("precious")
    (run / "arm.spine.log").symlink_to(victim)
    assert rig.run(wait=False).wait(60) == 1
    assert f"{run}: is not used: it is a folder of " in rig.log() and "(mode 0777)" in rig.log()
    assert f"close it (chmod o-w {run}), or set LITHE_RUN_DIR" in rig.log()
    assert os.listdir(run) == ["arm.spine.log"] and victim.read_text() == "precious"
    gateway = [
        sys.executable,
        "-c",
        "from lithe.gateway import *; from lithe.control import *; write_token(run_dir() / 't')",
    ]
    told = subprocess.run(gateway, env=rig.env, check=False, capture_output=True, text=True)
    assert told.returncode != 0 and f"{run} is not used" in told.stderr and os.listdir(run) == ["arm.spine.log"]
    run.chmod(0o700)
    assert rig.run(wait=False).wait(60) == 1
    assert "arm.spine.log: is a symbolic link, not a file" in rig.log() and victim.read_text() == "precious"


def test_a_cache_that_others_can_fill_is_not_used(rig: RobotRig) -> None:
    """What is compiled there becomes the code of a robot, and of this Python."""
    cache = rig.dir / "cache"
    cache.mkdir()
    cache.chmod(0o777)
    rig.env["LITHE_CACHE_DIR"] = str(cache)
    assert rig.run(wait=False).wait(60) == 1
    assert f"{cache}: is not used" in rig.log() and "LITHE_CACHE_DIR" in rig.log()
    told = rig.lithe("law", "check", ROOT / "laws" / "pd.cpp")
    assert told.returncode != 0 and f"{cache}: is not used" in told.stderr
    python = [sys.executable, "-c", "from lithe.shim import load_shim; load_shim()"]
    said = subprocess.run(python, env=rig.env, check=False, capture_output=True, text=True)
    assert said.returncode != 0 and f"{cache} is not used" in said.stderr
    assert os.listdir(cache) == []
