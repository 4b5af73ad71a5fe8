# SPDX-License-Identifier: Apache-2.0
"""Nobody reads through the robot what he may not read himself."""

import json
import os
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
