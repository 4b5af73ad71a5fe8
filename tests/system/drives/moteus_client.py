# SPDX-License-Identifier: Apache-2.0
"""Drives a servo with the maker's own library, as its examples do, and prints what happened. argv: terminal, id."""

import asyncio
import json
import math
import sys
import time
from typing import Any

import moteus

WATCHDOG_S = 30.0  # a busy machine may let this process stand still for longer than the usual 0.1


async def main(path: str, device: int) -> None:
    """Query, move an eighth of a turn forth and less back, stop."""
    link = moteus.Fdcanusb(path)
    controller = moteus.Controller(id=device, transport=link)
    position = moteus.Register.POSITION
    before: Any = await controller.query()
    reached = {}
    for goal in (0.12, -0.08):
        end = time.monotonic() + 1.5
        while time.monotonic() < end:
            seen = await controller.set_position(
                position=goal,
                velocity=0.0,
                accel_limit=20.0,
                velocity_limit=2.0,
                watchdog_timeout=WATCHDOG_S,
                query=True,
            )
            await asyncio.sleep(0.005)
        reached[goal] = seen.values[position]
    held = await controller.set_position(position=math.nan, watchdog_timeout=WATCHDOG_S, query=True)
    await controller.set_stop()
    stopped: Any = await controller.query()
    print(
        json.dumps(
            {
                "id": before.id,
                "modes": [int(each.values[moteus.Register.MODE]) for each in (before, held, stopped)],
                "faults": [int(each.values[moteus.Register.FAULT]) for each in (before, held, stopped)],
                "voltage": before.values[moteus.Register.VOLTAGE],
                "start": before.values[position],
                "reached": list(reached.values()),
                "goals": list(reached),
            }
        )
    )


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], int(sys.argv[2])))
