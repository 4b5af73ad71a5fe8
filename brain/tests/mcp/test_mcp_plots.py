# SPDX-License-Identifier: Apache-2.0
"""Plots as resources of MCP: what is drawn, when there is nothing to draw, and how large a picture may be."""

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from lithe import LitheError
from lithe.errors import Refused
from lithe.gateway import documents
from lithe.mcp import plots
from lithe.mcp.server import Server
from matplotlib.image import imread

Json = dict[str, Any]
NAMES = ["shoulder", "$\\frac{$", *(f"joint_{k}" for k in range(8))]


def joint(name: str, old: float, new: float) -> Json:
    """What a certificate says of one."""
    before, after = ({"rms_error_rad": one, "max_error_rad": 2 * one, "rms_torque_nm": 0.5} for one in (old, new))
    return {"joint": name, "before": before, "after": after, "predicted_rms_error_rad": new / 2}


class Told:
    """A gateway that has swaps in a folder, and a minute of telemetry."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.minute_ticks = 3000
        self.tell(1, "pd", "confirmed", [joint("shoulder", 0.2, 0.1)])
        self.tell(2, "no_good", "refused", None)
        self.tell(3, "lqr", "rolled_back", [joint(name, 0.1, 0.01 * (k + 1)) for k, name in enumerate(NAMES)])
        self.tell(4, "oops", "refused", None)

    def tell(self, number: int, law: str, verdict: str, joints: list[Json] | None) -> None:
        control = {"control": {"joints": joints}} if joints is not None else {}
        path = self.folder / f"{number:04d}.json"
        path.write_text(json.dumps({"law": law, "verdict": verdict, **control}))

    def call(self, verb: str, args: Json) -> Any:
        if verb == "document":
            return documents.read(args["name"], lambda: self.folder)
        if verb == "describe":
            return {"rate_hz": 500.0, "joints": [{"name": name} for name in NAMES]}
        assert verb == "history" and args["every"] == 10, (verb, args)
        noise = np.random.default_rng(5).normal(size=(self.minute_ticks, len(NAMES)))
        ticks = list(range(10, 10 * self.minute_ticks + 10, 10))
        law_id = [1 if tick < 2000 else 2 for tick in ticks]
        still = np.zeros_like(noise)
        return {
            "tick": ticks,
            "law_id": law_id,
            "setpoint_position_rad": still.tolist(),
            "position_rad": noise.tolist(),
        }


@pytest.fixture
def told(tmp_path: Path) -> Told:
    return Told(tmp_path)


def test_the_history_of_laws_has_every_swap_and_the_error_of_every_joint(told: Told) -> None:
    (axis,) = plots.figure("plots/laws.png", told.call).axes
    assert [label.get_text() for label in axis.get_xticklabels()] == [
        "0001 pd",
        "0002 no_good",
        "0003 lqr",
        "0004 oops",
    ]
    lines = {str(line.get_label()): np.asarray(line.get_ydata(), float) for line in axis.get_lines()}
    np.testing.assert_array_equal(lines["shoulder"][:2], [0.1, np.nan])
    assert len(lines) <= plots.MOST_JOINTS


def test_the_last_measured_swap_is_drawn_with_the_worst_joints(told: Told) -> None:
    figure = plots.figure("plots/last-swap.png", told.call)
    assert figure.get_suptitle() == "swap 0003: lqr, rolled_back"
    rms = figure.axes[0]
    before, after, predicted = ([bar.get_height() for bar in bars] for bars in rms.containers)
    assert before == [0.1] * plots.MOST_JOINTS
    np.testing.assert_allclose(after, [0.1, 0.09, 0.08, 0.07, 0.06, 0.05])
    np.testing.assert_allclose(predicted, np.array(after) / 2)
    assert plots.figure("plots/swaps/0001.png", told.call).get_suptitle() == "swap 0001: pd, confirmed"


def test_the_last_minute_shows_the_worst_joints_and_where_the_law_changed(told: Told) -> None:
    axes = plots.figure("plots/recent.png", told.call).axes
    assert len(axes) == plots.MOST_JOINTS
    for axis in axes:
        error, change = axis.get_lines()
        assert len(np.asarray(error.get_xdata())) == told.minute_ticks
        assert np.asarray(change.get_xdata(), float)[0] == pytest.approx((2000 - 30000) / 500)


def test_every_picture_is_a_png_that_is_not_too_large(told: Told) -> None:
    answers: list[Json] = []
    server = Server(told.call, told.folder / "none")

    def ask(method: str, params: Json) -> Json:
        line = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        server.line(json.dumps(line).encode(), answers.append)
        server.finish()
        result: Json = answers[-1]["result"]
        return result

    for name in (*plots.ALWAYS, "plots/swaps/0003.png"):
        (resource,) = ask("resources/read", {"uri": f"lithe://{name}"})["contents"]
        (shown,) = ask("tools/call", {"name": "document", "arguments": {"name": name}})["content"]
        assert (resource["mimeType"], shown["mimeType"], shown["type"]) == ("image/png", "image/png", "image")
        png = base64.b64decode(resource["blob"], validate=True)
        assert len(png) <= plots.MOST_BYTES and len(base64.b64decode(shown["data"])) <= plots.MOST_BYTES
        height, width, _ = imread(io.BytesIO(png)).shape
        assert 300 < height <= 1200 and 300 < width <= 1200, name


def test_a_picture_that_stays_too_large_is_refused(told: Told, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plots, "MOST_BYTES", 1000)
    with pytest.raises(LitheError, match="more than 1000 bytes"):
        plots.drawn("plots/laws.png", told.call)


def test_what_cannot_be_drawn_says_why(told: Told) -> None:
    for name in ("plots/swaps/../x.png", "plots/law.png", "plots/swaps/1.svg"):
        with pytest.raises(Refused, match="plots/laws.png"):
            plots.drawn(name, told.call)
    with pytest.raises(LitheError, match="swap 0002 was not measured; its verdict: refused"):
        plots.drawn("plots/swaps/0002.png", told.call)
    with pytest.raises(Refused, match="cannot read 9999.json"):
        plots.drawn("plots/swaps/9999.png", told.call)
    for path in told.folder.iterdir():
        path.unlink()
    for name in ("plots/laws.png", "plots/last-swap.png"):
        with pytest.raises(LitheError, match="while a reference runs"):
            plots.drawn(name, told.call)
