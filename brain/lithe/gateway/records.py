# SPDX-License-Identifier: Apache-2.0
"""The verbs that read telemetry: `latest`, `history`, `measure`.

Threads: all methods may be called from any thread; long answers are made one at a time (turns.py).
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from .. import incident
from ..errors import Refused
from ..mailbox import params_of
from ..robot import Robot
from ..shm import dtype
from ..vocabulary import nearest
from .answers import Encoded, as_json
from .measure import aligned_error_rad, measured, sample_age_s
from .past import KEPT_S, Past
from .turns import MOST_UNSENT_BYTES, Turns

Args = dict[str, Any]
MOST_LONG_BYTES = MOST_UNSENT_BYTES // 4
PIECE_TICKS = 128  # of a history, made at a time
USUAL = ["tick", "release_ns", "position_rad"]
MADE = ("error_rad", "sample_age_s")  # of other fields; see measure.py
DIGITS, ALL_DIGITS = 6, 9  # after the point: a micrometre at the end of a link of a metre


class Records:
    """Of one robot. See above."""

    def __init__(self, robot: Robot, turns: Turns) -> None:
        self._robot, self.turns = robot, turns
        self._past = Past(robot)

    def latest(self, args: Args) -> Any:
        """The newest record."""
        record = self._robot.telemetry.latest()
        if record is None:
            raise Refused("not_ready", "no tick yet", "ask again")
        return self._columns(record, self._fields(args, list(record.dtype.names or ())), self._joints({}), args)

    def history(self, args: Args) -> Encoded:
        """Records after tick `since_tick`, else of the last `seconds`, or those kept with `incident`; of these the
        ticks that `every` divides, up to `until_tick`, and of arrays by joint the columns of `joints`.

        Before what the Spine still has, `seconds` goes on with thinned records: `thinned` says which.
        """
        with self.turns.long_answer():
            told = self._kept(args) if "incident" in args else self._recent(args)
            self.turns.keep(len(told))
            return told

    def measure(self, args: Args) -> Any:
        """How well the running law follows; with its name and its parameters."""
        with self.turns.long_answer():
            told = measured(*self._past.window(_seconds(args, 4.0)), self._robot.spine.joint_names)
        law, live = params_of(self._robot.spine), self._robot.spine.params()
        if law["law_id"] != told["law_id"]:  # another one runs since
            return told
        told = {"law": law["law"], **told, "params": {each["name"]: each["value"] for each in law["params"]}}
        if live is not None and told["from_tick"] < int(live["tick"]) and told["ticks"]:
            told["params_since_tick"] = int(live["tick"])
        return told

    def _recent(self, args: Args) -> Encoded:
        since = int(args["since_tick"]) if "since_tick" in args else None
        seconds = _seconds(args, 1.0)
        pieces, wanted = self._robot.telemetry.pieces(PIECE_TICKS, since_tick=since, seconds=seconds)
        full = next((piece for piece in pieces if len(piece)), np.empty(0, dtype("Telemetry")))
        older, more = full[:0], {}
        if since is None and len(full):
            older = self._past.before(int(full["tick"][0]), time.monotonic_ns() - int(seconds * 1e9))
        if len(older):
            more = {"thinned": {"every": self._past.every, "before_tick": int(full["tick"][0])}}
        seen = [0]

        def counted() -> Iterable[npt.NDArray[Any]]:
            yield older
            for records in itertools.chain([full], pieces):
                seen[0] += len(records)
                yield records

        columns = self._joined(counted(), args)
        return _object(columns, {"lost": 0 if since is None else wanted - seen[0], **more})

    def _kept(self, args: Args) -> Encoded:
        """What the flight recorder kept around an incident: every tick."""
        summary = self._robot.call("incident", id=int(args["incident"]))
        _, records = incident.load(Path(summary["folder"]) / summary["data"])
        pieces = (records[i : i + PIECE_TICKS] for i in range(0, len(records), PIECE_TICKS))
        more = {"incident": summary["id"], "at_tick": summary["tick"], "what": summary["what"]}
        return _object(self._joined(pieces, args), {"lost": 0, **more})

    def _joined(self, pieces: Iterable[npt.NDArray[Any]], args: Args) -> dict[str, list[bytes]]:
        fields, joints = self._fields(args, USUAL), self._joints(args)
        until = int(args.get("until_tick", np.iinfo(np.int64).max))
        every = max(1, int(args.get("every", 1)))
        columns: dict[str, list[bytes]] = {name: [] for name in fields}
        size = 0
        for records in pieces:
            self.turns.pause()
            chosen = records[(records["tick"] % every == 0) & (records["tick"] <= until)]
            if not len(chosen):
                continue
            for name, values in self._columns(chosen, fields, joints, args).items():
                columns[name].append(as_json(values)[1:-1].encode())
                size += len(columns[name][-1]) + 2
            if size > MOST_LONG_BYTES:
                raise Refused(
                    "too_long",
                    f"the answer would be longer than {MOST_LONG_BYTES >> 20} MiB",
                    "fewer fields, every=N, or several times with since_tick",
                )
        return columns

    def _fields(self, args: Args, usual: list[str]) -> list[str]:
        known = (*MADE, *(dtype("Telemetry").names or ()))
        fields = args.get("fields") or usual
        _few(fields, known, "fields")
        for name in fields:
            if name not in known:
                raise Refused("unknown_field", f"telemetry has no field '{name}'", f"one of {', '.join(known)}")
        return list(fields)

    def _joints(self, args: Args) -> list[int]:
        known = list(self._robot.spine.joint_names)
        _few(args.get("joints") or (), known, "joints")
        for name in args.get("joints") or ():
            if name not in known:
                raise Refused("unknown_joint", f"there is no joint '{name}'", nearest(str(name), known))
        return [known.index(name) for name in args.get("joints") or known]

    def _columns(self, records: Any, fields: list[str], joints: list[int], args: Args) -> dict[str, Any]:
        """`brief` (the default): rounded, and of the probes those that the running law declares."""
        short, out = bool(args.get("brief", True)), dict[str, Any]()
        for name in fields:
            column = _made(records, name) if name in MADE else records[name]
            if column.dtype.kind == "f":
                column = np.round(column, DIGITS if short else ALL_DIGITS)
            if name == "probe" and short:
                law = self._robot.spine.running_law()
                column = column[..., : 0 if law is None else int(law["probe_count"])]
            if name == "sensor":  # JSON has no NaN: an invalid value is null
                valid = column[..., : len(self._robot.spine.sensor_names)].astype(object)
                valid[np.isnan(column[..., : valid.shape[-1]])] = None
                out[name] = valid.tolist()
            elif name == "input":
                out[name] = column[..., : int(self._robot.spine.info["input_count"])].tolist()
            elif column.ndim > records.ndim and name != "probe":
                out[name] = column[..., joints].tolist()
            else:
                out[name] = column.tolist()
        return out


def _made(records: Any, name: str) -> npt.NDArray[np.float64]:
    rows = np.atleast_1d(records)
    made = aligned_error_rad(rows) if name == "error_rad" else sample_age_s(rows)
    return made if np.ndim(records) else np.asarray(made[0])


def _seconds(args: Args, usual: float) -> float:
    seconds = float(args.get("seconds", usual))
    if not 0 < seconds <= KEPT_S:
        raise Refused("usage", f"seconds = {seconds:g}", f"above 0, at most {KEPT_S:g}: no more is kept")
    return seconds


def _few(names: Sequence[str], known: Sequence[str], what: str) -> None:
    """Each name may stand there once: more would keep the gateway busy for nothing."""
    if len(names) > len(known):
        raise Refused("too_many", f"{len(names)} {what}; there are {len(known)}", "name each of them once")


def _object(columns: dict[str, list[bytes]], more: Args) -> Encoded:
    parts = [as_json(name).encode() + b": [" + b", ".join(texts) + b"]" for name, texts in columns.items()]
    parts += [as_json(name).encode() + b": " + as_json(value).encode() for name, value in more.items()]
    return Encoded(b"{" + b", ".join(parts) + b"}")
