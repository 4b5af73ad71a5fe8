# SPDX-License-Identifier: Apache-2.0
"""What a user of the drive maker's Python library writes: an asyncio loop at 1 kHz. argv: terminal, id of the drive.

Nothing of LITHE is in it. Each line of standard input is a number of cycles; the answer is a line of JSON: how late
each cycle began [ns]. A release that passed while the loop was busy is skipped, and counts with its lateness.
"""

import asyncio
import json
import math
import sys
import time

import moteus  # type: ignore[import-not-found,unused-ignore]  # tools/pypi.py installs it

PERIOD_NS = 1_000_000
ANSWER_S = 1.0  # an exchange that takes longer is given up


async def cycles(controller: moteus.Controller, count: int) -> list[int]:
    """How late each of so many releases was [ns]."""
    late_ns: list[int] = []
    release_ns = time.monotonic_ns()
    while len(late_ns) < count:
        release_ns += PERIOD_NS
        while (behind_ns := time.monotonic_ns() - release_ns) >= PERIOD_NS and len(late_ns) < count - 1:
            late_ns.append(behind_ns)
            release_ns += PERIOD_NS
        await asyncio.sleep(max(0.0, -behind_ns * 1e-9))
        late_ns.append(max(0, time.monotonic_ns() - release_ns))
        try:
            await asyncio.wait_for(controller.set_position(position=math.nan, velocity=0.0, query=True), ANSWER_S)
        except TimeoutError:
            continue
    return late_ns


async def main(path: str, device: int) -> None:
    """Serve."""
    controller = moteus.Controller(id=device, transport=moteus.Fdcanusb(path))
    await asyncio.wait_for(controller.set_stop(query=True), 20 * ANSWER_S)
    print('"ready"', flush=True)
    for line in sys.stdin:
        print(json.dumps(await cycles(controller, int(line))), flush=True)
    await controller.set_stop()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
