"""The verdict of a run as the ledger of its bench keeps it: a later run, or other limits, do not make it forgotten."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bench.base.bounded_json import canonical_json

if TYPE_CHECKING:
    from bench.record.results import Results

Limits = tuple[str, float | None, float | None]
"""A result, its lower and its upper limit."""


class RunVerdict(NamedTuple):
    """PASS or FAIL of a run, and by what."""

    verdict: Literal["PASS", "FAIL"] | None  # None for a run without limits
    specifications: Mapping[str, str]  # `hash_of_limits` of each specification, by its name
    limits_stated_before: bool  # Whether the limits stood in the documents of the run
    camera: str  # Serial number that the camera stated; empty if it states none


def run_verdict(results: Results) -> RunVerdict:
    """Return the verdict that results of a run state; its limits are those of its documents."""
    camera = (results.get("devices") or {}).get("camera") or {}
    judged = results.get("conformity")
    serial = str(camera.get("serial") or "")
    if judged is None:
        return RunVerdict(None, {}, limits_stated_before=False, camera=serial)
    by_name: dict[str, list[Limits]] = {}
    for statement in judged.statements:
        limits = (statement.result, statement.lower, statement.upper)
        by_name.setdefault(statement.specification, []).append(limits)
    return RunVerdict(
        "PASS" if judged.passed else "FAIL", hashes_of(by_name), limits_stated_before=True, camera=serial
    )


def hashes_of(limits: Mapping[str, Iterable[Limits]]) -> dict[str, str]:
    """Return for each specification the SHA-256 of its limits: the same name with other limits has another one."""
    return {
        name: hashlib.sha256(canonical_json(sorted(set(of), key=repr))).hexdigest()
        for name, of in limits.items()
    }


def read_verdict(data: Mapping[str, Any]) -> RunVerdict | None:
    """Read the verdict of a line of the ledger; None if it has none, as lines of earlier versions."""
    stated = data.get("verdict")
    return None if stated is None else RunVerdict(**stated)
