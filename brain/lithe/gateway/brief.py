# SPDX-License-Identifier: Apache-2.0
"""A swap's answer in less than 1 kB: what a language model needs to go on, and where the certificate is."""

from __future__ import annotations

import json
from typing import Any

Json = dict[str, Any]
MOST_BYTES = 1000
# In this order, as long as there is room.
FIRST = ("verdict", "law", "law_id", "commit_tick", "missed_releases", "record_lost", "cleaned")


def _rounded(value: Any) -> Any:
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return float(f"{value:.4g}") if isinstance(value, float) else value


def _parts(certificate: Json) -> Json:
    """What is told of it, the most important first."""
    parts: Json = {}
    if "certificate" in certificate:
        parts["certificate"] = "swaps/" + str(certificate["certificate"]).removesuffix(".json")
    parts |= {key: certificate[key] for key in FIRST if key in certificate}
    if fields := (certificate.get("state_not_carried") or {}).get("fields"):
        parts["state_not_carried"] = fields
    trial = certificate.get("trial") or {}
    for number, warning in enumerate(trial.get("warnings") or []):
        parts[f"warning_{number + 1}"] = warning
    if shadow := certificate.get("shadow"):
        parts |= {f"shadow_{key}": shadow[key] for key in ("ticks", "most_nm", "rms_nm")}
    for joint in (certificate.get("control") or {}).get("joints") or []:
        name = joint.get("joint")
        parts[f"predicted_rms_error_rad_{name}"] = joint.get("predicted_rms_error_rad")
    return parts


def brief(certificate: Json) -> Json:
    """Less than 1 kB of JSON."""
    told: Json = {}
    for key, value in _parts(certificate).items():
        more = told | {key: _rounded(value)}
        if len(json.dumps(more)) < MOST_BYTES:
            told = more
    return told


def brief_detail(detail: Json) -> Json:
    """The same of a refusal: where its certificate is, and what else is short."""
    told = brief({"certificate": swap["certificate"]}) if "certificate" in (swap := detail.get("swap") or {}) else {}
    for key, value in detail.items():
        more = told | {key: _rounded(value)}
        if key != "swap" and len(json.dumps(more)) < MOST_BYTES:
            told = more
    return told
