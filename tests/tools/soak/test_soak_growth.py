# SPDX-License-Identifier: Apache-2.0
"""The soak's judgement of growth: what a process may gain while it warms up, and what it may not."""

from collections.abc import Callable

import numpy as np
import pytest
from soak import growth
from soak.judge import Broken


def breaks(check: Callable[[], object]) -> str:
    """That the check breaks the invariant `growth`; why."""
    with pytest.raises(Broken) as caught:
        check()
    assert caught.value.invariant == "growth"
    return caught.value.why


def grown(per_hour: float, noise: float = 30.0, seconds: int = 1200, lives: int = 1) -> list[growth.Sample]:
    """Samples every five seconds of one process after the other; each fills its caches in its first minute."""
    random = np.random.default_rng(1)
    return [
        (
            life,
            life * seconds + t,
            20_000 + 500 * life + 3_000 * min(t / 60, 1) + per_hour * t / 3600 + random.normal(0, noise),
        )
        for life in range(lives)
        for t in range(0, seconds, 5)
    ]


@pytest.mark.parametrize("lives", [1, 3])
def test_a_process_that_grows_is_seen_and_one_that_only_warms_up_is_not(lives: int) -> None:
    assert "no process" in growth.judged({"lawd_rss_kb": grown(9e4, seconds=120)})["lawd_rss_kb"]
    told = growth.judged({"spine_rss_kb": grown(0, lives=lives)})["spine_rss_kb"]
    assert told["low"] < 0 < told["high"] and told["high"] < 500
    leaking = {"spine_rss_kb": grown(30_000, lives=lives)}
    assert "spine_rss_kb grows by" in breaks(lambda: growth.judged(leaking))
    filling = growth.judged({"supervisor_rss_kb": grown(30_000, seconds=1000)})
    assert "no process" in filling["supervisor_rss_kb"], "its log of events fills"
    breaks(lambda: growth.judged({"supervisor_rss_kb": grown(30_000, seconds=2400)}))
    fds = {"supervisor_fds": [(1, t, 20.0 + t // 60) for t in range(0, 1200, 5)]}
    assert "supervisor_fds" in breaks(lambda: growth.judged(fds))
