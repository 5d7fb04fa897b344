"""Rows of the table of runs: one run as one mapping by column. Pure: it reads no file."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from bench.evidence.shown_state import ShownState
from bench.history.merged_runs import RunPlace
from bench.history.table_schema import COLUMNS, PARAMETERS, SCHEMA, parameter_columns
from bench.records.run_index import IndexedRun

_COPIED = frozenset(column.name for column in COLUMNS)


def kind_of(run: IndexedRun) -> str:
    """Return what a run is.

    Returns: ``measured``, ``simulated`` or ``rehearsed``.
    """
    return "rehearsed" if run.rehearsal else "simulated" if run.simulated else "measured"


def table_row(
    run: IndexedRun, details: Mapping[str, Any], place: RunPlace, state: ShownState
) -> dict[str, Any]:
    """Return the row of a run.

    Returns: Value by column, in the order of `table_schema.COLUMNS`; None where nothing is known.
    """
    row: dict[str, Any] = dict.fromkeys(column.name for column in COLUMNS)
    row |= {name: value for name, value in details.items() if name in _COPIED}
    software = details.get("software") or {}
    row |= {
        "schema": SCHEMA,
        "run": run.id,
        "folder": run.folder,
        "kind": kind_of(run),
        "simulated": run.simulated,
        "outcome": run.how,
        "begun_utc": run.begun_utc,
        "sequence": run.sequence,
        "operator": run.operator,
        "station": run.station,
        "bench": place.bench or None,
        "ledger": place.ledger or None,
        "ledger_state": place.state,
        "ledger_number": run.ledger_number,
        "ledger_head": run.ledger_head,
        "evidence_state": str(state.state),
        "evidence": state.text,
        "camera_serial": run.camera or None,
        "temperature_c": run.temperature_c,
        "poses_accepted": run.accepted,
        "recordings": run.recordings,
        "model": run.model,
        "rms_px": run.rms_px,
        "coverage_factor": run.coverage_factor,
        "software_starbench": software.get("starbench"),
        "software_program": software.get("program"),
        "software": json.dumps(software, sort_keys=True) if software else None,
        **_parameters(run),
    }
    return {column.name: _fitted(row[column.name], column.kind) for column in COLUMNS}


def _parameters(run: IndexedRun) -> dict[str, Any]:
    row: dict[str, Any] = {}
    other = {}
    for name, one in run.parameters.items():
        if name not in PARAMETERS:
            other[name] = {"value": _finite(one.value), "sigma": _finite(one.sigma)}
            continue
        expanded = one.expanded if run.coverage_factor is not None else None
        row |= dict(zip(parameter_columns(name), (one.value, one.sigma, expanded), strict=True))
    row["other_parameters"] = json.dumps(other) if other else None
    return row


def _finite(value: object) -> float | None:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None  # type: ignore[arg-type]


def _fitted(value: Any, kind: str) -> Any:
    """Return a value as its column holds it; None if it is not of that kind."""
    if value is None:
        return [] if kind == "texts" else None
    return _FITTED[kind](value)


def _whole(value: object) -> int | None:
    number = _finite(value)
    return int(number) if number is not None and abs(number) < 2**63 else None


def _moment(text: object) -> datetime | None:
    try:
        found = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found.astimezone(UTC)


_FITTED: Mapping[str, Callable[[Any], Any]] = {
    "number": _finite,
    "integer": _whole,
    "truth": lambda value: value if isinstance(value, bool) else None,
    "moment": _moment,
    "texts": lambda value: [str(one) for one in value] if isinstance(value, list) else [],
    "text": str,
}
