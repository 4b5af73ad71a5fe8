# SPDX-License-Identifier: Apache-2.0
"""`python -m lithe.model ROBOT.toml FILE [--write OUT.toml]`: the guard's model of the links, from a URDF or MJCF file.

Prints `[model]` and a `[joint.model]` for each joint, or writes the robot file with them; never one that is there
already. Joints of FILE that the robot does not have count as fixed. Exit 0: done; 2: a file cannot be read or written.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..errors import LitheError
from ..files import read_regular, robot_table
from ..identify.plant import write_new
from .links import links_of, tables, with_links


def run(asked: argparse.Namespace) -> None:
    try:
        text = read_regular(asked.robot)
        names = [str(joint["name"]) for joint in robot_table(text)["joint"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise LitheError(f"cannot read {asked.robot}: {error}\n  next: give a robot file") from None
    links, gravity_m_s2, fixed = links_of(asked.file, names)
    if fixed:
        print(f"note: the robot has no joint {', '.join(fixed)}: taken as fixed at angle 0", file=sys.stderr)
    if asked.write is None:
        top, of_joint = tables(links, gravity_m_s2)
        print(top + "".join(f"\n# {name}\n{table}" for name, table in of_joint.items()), end="")
    else:
        write_new(asked.write, with_links(text, links, gravity_m_s2))


def main(words: list[str]) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="python -m lithe.model", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("robot", type=Path, help="a robot file")
    parser.add_argument("file", type=Path, help="its links, URDF or MJCF; needs pin")
    parser.add_argument("--write", type=Path, metavar="OUT.toml", help="the robot file with its model")
    try:
        run(parser.parse_args(words))
    except LitheError as error:
        print(f"lithe.model: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
