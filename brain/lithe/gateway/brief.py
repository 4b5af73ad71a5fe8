# SPDX-License-Identifier: Apache-2.0
"""A swap in less than 1 kB: what a language model needs to go on, and where the certificate is."""

from __future__ import annotations

import difflib
import json
import math
from collections.abc import Sequence
from typing import Any

Json = dict[str, Any]
MOST_BYTES = 1000
MOST_JOINTS_BYTES = 450  # so that a robot with many joints leaves room for warnings
MOST_ERROR_BYTES = 500
MOST_HINTS_BYTES = 580  # two whole ones: spine/law/diagnosis.hpp makes none above 280 letters
MOST_CLEANED_BYTES = 150
MOST_DIFF_BYTES = 800
MOST_STATUS_BYTES = 1500
MOST_ALARMS_BYTES, MOST_PART_BYTES = 450, 250
CUT = "..."
STATUS = (
    "robot", "mode", "fault", "recovering", "law", "law_id", "probation", "tick", "age_ms", "missed_releases",
    "late_samples", "plan", "brain_age_ms", "gates",
)  # fmt: skip
LAST_SWAP = ("verdict", "law", "source", "request_id", "certificate", "reason")
# In this order, as long as there is room.
FIRST = (
    "verdict",
    "law",
    "source",
    "law_id",
    "commit_tick",
    "missed_releases",
    "record_lost",
    "refused_after",
    "probation",
)


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    if isinstance(value, dict):
        return {key: _rounded(one) for key, one in value.items()}
    return float(f"{value:.4g}") if isinstance(value, float) else value


def _size(value: Any) -> int:
    return len(json.dumps(value))


def beginning(value: Any, most_bytes: int) -> Any:
    """As much of a JSON value as fits: of a text its beginning, of lists and objects what has room. None: nothing."""
    if _size(value) <= most_bytes:
        return value
    if isinstance(value, str):
        kept = value[: max(0, most_bytes - len(CUT) - 2)]
        while kept and _size(kept + CUT) > most_bytes:  # a character may take twelve bytes
            kept = kept[:-1]
        return kept + CUT if kept else None
    if isinstance(value, list):
        items: list[Any] = []
        for each in value:
            part = beginning(each, most_bytes - _size(items) - 2)
            if part is None:
                break
            items.append(part)
        return items or None
    fields: Json = {}
    for key, each in value.items() if isinstance(value, dict) else ():
        part = beginning(each, most_bytes - _size(fields) - _size(key) - 4)
        if part is not None:
            fields[key] = part
    return fields or None


def _became(one: tuple[str, Json]) -> tuple[float, float]:
    """By which factor its error grew (infinite: there was none before), and the error."""
    rms = one[1]["rms_error_rad"]
    old, new = float(rms["old"] or 0.0), float(rms["new"] or 0.0)
    return (new / old if old else math.inf if new else 0.0), new


def _joints(control: Json) -> Json:
    """Old law beside new and what the trial predicted; first the joint that became worst, by new error / old error."""
    each: Json = {}
    for joint in control.get("joints") or []:
        old, new = joint.get("before") or {}, joint.get("after") or {}
        rms = {"old": old.get("rms_error_rad"), "new": new.get("rms_error_rad"),
               "predicted": joint.get("predicted_rms_error_rad")}  # fmt: skip
        if "late_rms_error_rad" in joint:
            rms["new_late"] = joint["late_rms_error_rad"]
        each[str(joint.get("joint"))] = {"rms_error_rad": rms, "chatter_hz": new.get("chatter_hz")}
    worst: Json = _rounded(dict(sorted(each.items(), key=_became, reverse=True)))
    kept = beginning(worst, MOST_JOINTS_BYTES) or {}
    whole = {name: told for name, told in kept.items() if told == worst[name]}
    return {"joints": whole} | ({"joints_left_out": len(each) - len(whole)} if len(whole) < len(each) else {})


def _hints(hints: list[str]) -> Json:
    """As many as there is room for, none of them cut."""
    room = MOST_HINTS_BYTES
    kept: list[str] = []
    for hint in hints:
        room -= _size(hint) + 2
        if room < 0:
            break
        kept.append(hint)
    left_out = {"hints_left_out": len(hints) - len(kept)} if len(kept) < len(hints) else {}
    return ({"hints": kept} if kept else {}) | left_out


def _parts(certificate: Json, joints: Sequence[str] = ()) -> Json:
    """What is told of it, the most important first."""
    parts: Json = {}
    if "certificate" in certificate:
        parts["certificate"] = "swaps/" + str(certificate["certificate"]).removesuffix(".json")
    parts |= {key: certificate[key] for key in FIRST if key in certificate}
    parts |= _hints((certificate.get("trial") or {}).get("hints") or [])
    if "cleaned" in certificate:
        parts["cleaned"] = beginning(certificate["cleaned"], MOST_CLEANED_BYTES)
    for name in ("error", "rolled_back"):
        said = certificate.get(name) or {}
        if told := {key: said[key] for key in ("code", "message", "why", "law", "next") if key in said}:
            parts[name] = beginning(told, MOST_ERROR_BYTES)
    changes = certificate.get("param_changes") or []
    if back := [each for each in changes if each.get("verdict") == "reverted"]:
        parts["params_reverted"] = beginning(_taken_back(back[-1]), MOST_ERROR_BYTES)
    if control := certificate.get("control"):
        parts |= {key: (control.get("after") or {}).get(key) for key in ("clamped", "missed_ticks")}
        parts |= _joints(control)
    if values := (certificate.get("params") or {}).get("values"):
        parts["params"] = values
    if fields := (certificate.get("state_not_carried") or {}).get("fields"):
        parts["state_not_carried"] = fields
    if warnings := (certificate.get("trial") or {}).get("warnings"):
        parts["warnings"] = warnings
    if shadow := certificate.get("shadow"):
        parts["shadow_ticks"] = shadow["ticks"]
        parts |= {f"shadow_{key}": dict(zip(joints, shadow[key], strict=False)) for key in ("most_nm", "rms_nm")}
    return parts


def _taken_back(change: Json) -> Json:
    """Which values of a change of parameters did not stay, which hold again, and why."""
    words = (("why", "reason"), ("next", "next"), ("went_back_to", "went_back_to"), ("values", "values"))
    return {name: change[key] for name, key in words if key in change}


def brief_params(answer: Json) -> Json:
    """Less than 1 kB of params_with_verdict(): the verdict, what went back to which values and why, all values now."""
    tried = answer.get("tried") or {}
    parts: Json = {"verdict": tried.get("verdict", "taken")} | _taken_back(tried)
    parts |= {key: answer[key] for key in ("law", "law_id", "via") if key in answer}
    parts["params"] = {each["name"]: each["value"] for each in answer.get("params") or []}
    parts |= {key: answer[key] for key in ("warnings", "trial_ms") if answer.get(key)}
    told: Json = beginning(parts, MOST_BYTES - 1) or {}
    return told


def brief(certificate: Json, joints: Sequence[str] = ()) -> Json:
    """Less than 1 kB of JSON. `joints`: the robot's, in order."""
    told: Json = beginning(_rounded(_parts(certificate, joints)), MOST_BYTES - 1) or {}
    return told


def brief_status(status: Json) -> Json:
    """At most 1.5 kB of a status: what stops or limits the robot first; of a joint where it is and its problems."""
    parts: Json = {key: status[key] for key in STATUS if key in status}
    parts["alarms"] = beginning(status.get("alarms") or [], MOST_ALARMS_BYTES) or []
    for key, names in (("stopped_by", ("text", "next", "tick")), ("last_swap", LAST_SWAP)):
        whole = status.get(key) or {}
        parts[key] = beginning({name: whole[name] for name in names if name in whole}, MOST_PART_BYTES)
    joints = status.get("joints") or []
    bad = [each for each in joints if each.get("problems") or each.get("drive")]
    keys = ("name", "problems", "drive", "drive_state")
    parts["problems"] = beginning([{key: each.get(key) for key in keys} for each in bad], MOST_PART_BYTES) or []
    parts["position_rad"] = {each.get("name"): each.get("position_rad") for each in joints}
    parts["params"] = status.get("params")
    told: Json = beginning(_rounded(parts), MOST_STATUS_BYTES) or {}
    return told


def diff(running: str, new: str) -> Json:
    """What the new law has in place of the running one: the lines that differ, as many as fit, and their number."""
    told = list(difflib.unified_diff(running.splitlines(), new.splitlines(), lineterm="", n=0))[2:]
    lines = [line for line in told if not line.startswith("@@")]
    kept = beginning(lines, MOST_DIFF_BYTES) or []
    return {"lines": len(lines), "text": kept}


def brief_detail(detail: Json) -> Json:
    """The same of a refusal: where its certificate is, and as much of the rest as there is room for."""
    told = detail | {"hints": (detail.get("trial") or {}).get("hints")}
    certificate = (detail.get("swap") or {}).get("certificate")
    parts = _parts({"certificate": certificate} if certificate else {})
    parts |= {key: told[key] for key in ("stage", "where", "hints", "diagnostics", "text") if told.get(key)}
    parts |= {key: value for key, value in detail.items() if key not in {"swap", "trial", *parts}}
    short: Json = beginning(_rounded(parts), MOST_BYTES - 1) or {}
    return short
