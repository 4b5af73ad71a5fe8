# SPDX-License-Identifier: Apache-2.0
"""tools/timing_figure.py draws what the telemetry says, and nothing where it says nothing."""

import xml.etree.ElementTree as ET
from dataclasses import replace

import numpy as np
import pytest
import timing_figure
from lithe._wire import TelemetryFlags
from synthetic import records

COMMIT = 2000
SPLIT_MS = {"queued": 0.5, "compiled": 300.0, "admitted": 9.0, "placed": 6.0, "tried": 15.0, "committed": 0.1}
SVG = "{http://www.w3.org/2000/svg}"


def run(inline: bool = False) -> timing_figure.Run:
    """Ticks of 5 us whose law takes 0.4 and whose guard takes 0.9 of them, and a commit in their middle."""
    made = records(4000)
    made["law_ns"], made["guard_ns"], made["handoff_ns"], made["bus_ns"] = 400, 900, 200, 21_000
    made["tick_ns"] = 5_000
    made["law_id"] = np.where(made["tick"] < COMMIT, 1, 2)
    made["flags"] = np.where(abs(made["tick"].astype(int) - COMMIT - 10) < 10, TelemetryFlags.blending, 0)
    return timing_figure.Run(made, 1000.0, inline, ("pd", "gravity_pd"), COMMIT, SPLIT_MS, "a machine")


@pytest.mark.parametrize("inline", [False, True])
def test_the_figure_is_svg_and_tells_the_numbers(inline: bool) -> None:
    figure = ET.fromstring(timing_figure.draw(run(inline)))
    assert figure.tag == f"{SVG}svg"
    words = " ".join("".join(each.itertext()) for each in figure.iter())
    for expected in ("5.00 µs", "law 0.40", "guard 0.90", "331 ms from the request", "compiled 300.0", "blend: "):
        assert expected in words, expected
    assert ("a thread of its own" in words) != inline
    assert f"the commit {COMMIT}" in words


def test_the_bus_begins_where_the_records_say() -> None:
    threaded = timing_figure.spans_of(run(), 100, int(run().records["release_ns"][100]))
    late_us = int(run().records["release_jitter_ns"][100]) / 1e3
    assert threaded["tick"] == pytest.approx((late_us, late_us + 5.0))
    assert threaded["bus"] == pytest.approx((late_us + 0.2, late_us + 21.2))


def test_a_commit_that_the_records_do_not_show_is_refused() -> None:
    with pytest.raises(ValueError, match="around tick 9000"):
        timing_figure.draw(replace(run(), commit_tick=9000))
