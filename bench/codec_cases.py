# SPDX-License-Identifier: Apache-2.0
"""The maker's own Python library as a peer of our codec, and the frames that all peers write and read.

Run by Python with that library in its path. argv: the file for the cases, and their number. It writes the cases, and
then works as a peer. First it prints the frames that it writes and the values that it reads,
{"frames": [hex, ...], "reads": [[number, ...], ...]}. Then, for each line on the standard input, it prints the time,
{"encode_ns": ..., "parse_ns": ...}: one line of JSON each, nanoseconds per case.
A case is a position command with all seven numbers as floats, which asks for mode, position, velocity, torque,
voltage, temperature and fault, as the library writes it; and an answer of a drive, with the values that the library
reads from it.
"""

import json
import random
import struct
import sys
import time
from pathlib import Path
from typing import Any

import moteus  # type: ignore[import-not-found,unused-ignore]
from moteus.protocol import parse_reply  # type: ignore[import-not-found,unused-ignore]

FIELDS = {
    "position": 3.0,
    "velocity": 20.0,
    "feedforward_torque": 2.0,
    "kp_scale": 1.0,
    "kd_scale": 1.0,
    "maximum_torque": 3.0,
    "watchdog_timeout": 0.2,
}
READ = (0x000, 0x001, 0x002, 0x003, 0x00D, 0x00E, 0x00F)


def as_float(value: float) -> float:
    """Rounded to a float, so that all peers write the same bytes."""
    return float(struct.unpack("<f", struct.pack("<f", value))[0])


def controller() -> Any:
    """Commands in floats; asks for the values that a control loop needs."""
    made = moteus.Controller(id=1, transport=object())
    for name in FIELDS:
        setattr(made.position_resolution, name, moteus.multiplex.F32)
    for name in ("position", "velocity", "torque"):
        setattr(made.query_resolution, name, moteus.multiplex.F32)
    return made


def answer(lot: random.Random) -> bytes:
    """The answer of a drive to that query."""
    mode, fault = bytes((0x21, 0x00, 10)), bytes((0x23, 0x0D, 48, 25, 0))
    return mode + bytes((0x2F, 0x01)) + struct.pack("<fff", lot.uniform(-3, 3), lot.uniform(-20, 20), 0.5) + fault


def make(made: Any, count: int) -> list[dict[str, Any]]:
    """Random commands and answers."""
    lot = random.Random(4)
    cases = []
    for _ in range(count):
        values = {name: as_float(lot.uniform(0.01, most)) for name, most in FIELDS.items()}
        reply = answer(lot)
        read = parse_reply(reply)
        cases.append(
            {
                "values": list(values.values()),
                "frame": made.make_position(**values, query=True).data.hex(),
                "reply": reply.hex(),
                "read": [float(read[number]) for number in READ],
            }
        )
    return cases


def main() -> None:
    """Writes the cases, then measures once per line on the standard input."""
    made = controller()
    cases = make(made, int(sys.argv[2]))
    Path(sys.argv[1]).write_text("".join(json.dumps(case) + "\n" for case in cases))
    commands = [dict(zip(FIELDS, case["values"], strict=True)) for case in cases]
    replies = [bytes.fromhex(case["reply"]) for case in cases]
    print(
        json.dumps({"frames": [case["frame"] for case in cases], "reads": [case["read"] for case in cases]}), flush=True
    )
    for _ in sys.stdin:
        began = time.perf_counter_ns()
        for command in commands:
            made.make_position(**command, query=True)
        encoded = time.perf_counter_ns()
        for reply in replies:
            parse_reply(reply)
        parsed = time.perf_counter_ns()
        each = {"encode_ns": (encoded - began) / len(cases), "parse_ns": (parsed - encoded) / len(cases)}
        print(json.dumps(each), flush=True)


if __name__ == "__main__":
    main()
