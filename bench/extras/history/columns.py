"""The columns of the table of runs: name, kind, unit, meaning.

`starbench schema runs-table` prints them. Names carry their unit. No two names differ in capital letters only, because
DuckDB does not tell them apart.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Literal, NamedTuple

from bench.evidence.states import ShownState
from bench.record.run_facts import IndexedRun, RunDetails, RunPlace
from bench.wording.parameters import MEANINGS, unit_text

SCHEMA = "starbench/runs-table/1"
"""Name and version. Columns may be added within a version; they are never removed or given another meaning."""

Kind = Literal["text", "texts", "integer", "number", "truth", "moment"]

PARAMETERS = tuple(MEANINGS)
"""Parameters that have columns of their own."""

Cell = str | float | bool | datetime | list[str] | None
"""A value of the table; None if it is not known."""
Row = Mapping[str, Cell]
"""A run, by column."""


class Column(NamedTuple):
    """A column of the table."""

    name: str
    kind: Kind
    unit: str  # Empty where there is none
    meaning: str


_IDENTITY: Sequence[Column] = (
    Column("schema", "text", "", "name and version of this schema"),
    Column("run", "text", "", "name of the run"),
    Column("folder", "text", "", "folder of the run"),
    Column("kind", "text", "", "`measured`, `simulated` or `rehearsed`; never mix them"),
    Column("simulated", "truth", "", "whether any device was simulated"),
    Column("outcome", "text", "", "`finished`, `aborted`, `failed`, `running` or `cut off`"),
    Column("begun_utc", "moment", "", "begin of the run"),
    Column("ended_utc", "moment", "", "end of the run; empty while it has none"),
    Column("sequence", "text", "", "name of the sequence"),
    Column("operator", "text", "", "operator, if one was named"),
    Column("laboratory", "text", "", "laboratory, as the station file states it"),
    Column("station", "text", "", "name of the station"),
)
_LEDGER: Sequence[Column] = (
    Column("bench", "text", "", "name of the bench in whose ledger the run stands"),
    Column("ledger", "text", "", "first 12 characters of the hash of the ledger's first line"),
    Column("ledger_state", "text", "", "`entered`, `not in the ledgers` or `no ledger`"),
    Column("ledger_number", "integer", "", "number of the run in its ledger"),
    Column("ledger_head", "text", "", "hash of the line that enters the run"),
    Column("evidence_state", "text", "", "`DRAFT`, `SEALED` or `AUTHORISED`: what the signatures say now"),
    Column("evidence", "text", "", "the same in words, with the names of the signers"),
)
_DEVICES: Sequence[Column] = (
    Column("camera_type", "text", "", "maker and model of the camera"),
    Column("camera_serial", "text", "", "serial number of the camera; may begin with zeros"),
    Column("camera_sensor", "text", "", "sensor of the camera"),
    Column("camera_firmware", "text", "", "firmware of the camera"),
    Column("camera_lens", "text", "", "lens, as the station file states it"),
    Column("image_width_px", "integer", "px", "width of the image"),
    Column("image_height_px", "integer", "px", "height of the image"),
    Column("stage_types", "texts", "", "maker and model of each axis"),
    Column("stage_serials", "texts", "", "serial number of each axis, in the same order"),
    Column("light_type", "text", "", "maker and model of the light's generator"),
    Column("light_serial", "text", "", "its serial number"),
    Column("collimator_serial", "text", "", "serial number of the collimator"),
    Column("target_serial", "text", "", "serial number of the target"),
    Column("passport_number", "text", "", "number of the collimator's certificate or passport"),
)
_CONDITIONS: Sequence[Column] = (
    Column("temperature_c", "number", "°C", "temperature of the camera, mean of the accepted recordings"),
    Column("temperature_min_c", "number", "°C", "lowest of these temperatures"),
    Column("temperature_max_c", "number", "°C", "highest of these temperatures"),
    Column("illumination_lux", "number", "lx", "illumination that the camera reports, mean"),
    Column("light_frequency_hz", "number", "Hz", "frequency set at the light"),
    Column("flicker_hz", "number", "Hz", "frequency measured in the recordings, mean"),
    Column("poses_accepted", "integer", "", "poses with an accepted recording"),
    Column("poses_skipped", "integer", "", "poses that were skipped"),
    Column("recordings", "integer", "", "recordings made, including lost ones"),
    Column("recordings_lost", "integer", "", "recordings that the camera could not complete"),
    Column("recordings_bytes", "integer", "byte", "size of the accepted recordings"),
    Column("events", "integer", "", "events in the accepted recordings"),
    Column("stars", "integer", "", "stars in the accepted recordings"),
    Column("resumed", "integer", "", "how often the run was resumed"),
)
_RESULT: Sequence[Column] = (
    Column("model", "text", "", "model of the collimator in the calibration"),
    Column("converged", "truth", "", "whether the calibration converged"),
    Column("rms_px", "number", "px", "root mean square of the residuals; it is no accuracy"),
    Column("degrees_of_freedom", "number", "", "degrees of freedom of the calibration"),
    Column(
        "coverage_factor", "number", "", "common k of the expanded uncertainties; a value can have its own"
    ),
    Column(
        "corner_expanded_px", "number", "px", "expanded uncertainty of an image point in the worst corner"
    ),
    Column(
        "conformity", "text", "", "`PASS` or `FAIL` by the limits of station and sequence; empty without any"
    ),
)
_RECORD: Sequence[Column] = (
    Column("other_parameters", "text", "", "JSON: parameters without columns, each with `value` and `sigma`"),
    Column("deviations", "texts", "", "deviations from the sequence"),
    Column("warnings", "texts", "", "remarks of the calibration, and what else restricts the result"),
    Column("seed", "integer", "", "seed of the run"),
    Column("software_starbench", "text", "", "version of Starbench"),
    Column("software_program", "text", "", "hash of the program's files"),
    Column("software", "text", "", "JSON: all versions"),
    Column("sequence_sha256", "text", "", "SHA-256 of the sequence file"),
    Column("station_sha256", "text", "", "SHA-256 of the station file"),
    Column("passport_sha256", "text", "", "SHA-256 of the collimator's passport"),
    Column("results_sha256", "text", "", "SHA-256 of results.json, as the journal states it"),
    Column("journal_head", "text", "", "hash of the last line of the journal"),
)


def parameter_columns(parameter: str) -> tuple[str, str, str]:
    """Return the columns of a parameter: its value, its standard uncertainty, and its expanded uncertainty.

    >>> parameter_columns("fx"), parameter_columns("k1")
    (('fx_px', 'fx_sigma_px', 'fx_expanded_px'), ('k1', 'k1_sigma', 'k1_expanded'))
    """
    unit = f"_{text}" if (text := unit_text(parameter)) else ""
    return f"{parameter}{unit}", f"{parameter}_sigma{unit}", f"{parameter}_expanded{unit}"


def _of_parameter(parameter: str) -> tuple[Column, ...]:
    unit = unit_text(parameter)
    meanings = (
        MEANINGS[parameter],
        f"standard uncertainty of {parameter}",
        f"expanded uncertainty of {parameter}, its own k times the standard uncertainty",
    )
    names = parameter_columns(parameter)
    return tuple(Column(name, "number", unit, text) for name, text in zip(names, meanings, strict=True))


COLUMNS: Sequence[Column] = (
    *_IDENTITY,
    *_LEDGER,
    *_DEVICES,
    *_CONDITIONS,
    *_RESULT,
    *(column for parameter in PARAMETERS for column in _of_parameter(parameter)),
    *_RECORD,
)
"""All columns, in order."""


def json_schema() -> dict[str, object]:
    """Return the JSON Schema of a row: for each column its type, its meaning and, where there is one, its unit."""
    return {
        "title": SCHEMA,
        "type": "object",
        "properties": {
            column.name: _KINDS[column.kind][0]
            | {"description": column.meaning}
            | ({"unit": column.unit} if column.unit else {})
            for column in COLUMNS
        },
    }


def table_row(run: IndexedRun, details: RunDetails, place: RunPlace, state: ShownState) -> Row:
    """Return the row of a run by column, in the order of `table_schema.COLUMNS`; None where nothing is known."""
    software = details["software"]
    known = {
        **vars(run),
        **details,
        "schema": SCHEMA,
        "run": run.id,
        "kind": run.kind,
        "outcome": run.how,
        "bench": place.bench or None,
        "ledger": place.ledger or None,
        "ledger_state": place.state,
        "evidence_state": str(state.state),
        "evidence": state.text,
        "camera_serial": run.camera or None,
        "poses_accepted": run.accepted,
        "software_starbench": software.get("starbench"),
        "software_program": software.get("program"),
        "software": json.dumps(software, sort_keys=True) if software else None,
        **_parameters(run),
    }
    return {column.name: _fitted(known.get(column.name), column.kind) for column in COLUMNS}


def _parameters(run: IndexedRun) -> Row:
    row: dict[str, Cell] = {}
    other = {}
    for name, parameter in run.parameters.items():
        if name not in PARAMETERS:
            other[name] = {"value": _finite(parameter.value), "sigma": _finite(parameter.sigma)}
            continue
        expanded = parameter.expanded if run.coverage_factor is not None else None
        row |= dict(zip(parameter_columns(name), (parameter.value, parameter.sigma, expanded), strict=True))
    row["other_parameters"] = json.dumps(other) if other else None
    return row


def _finite(value: object) -> float | None:
    usable = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if usable else None  # type: ignore[arg-type]


def _fitted(value: object, kind: Kind) -> Cell:
    """Return a value as its column holds it; None if it is not of that kind."""
    if value is None:
        return [] if kind == "texts" else None
    return _KINDS[kind][1](value)


def _whole(value: object) -> int | None:
    number = _finite(value)
    return int(number) if number is not None and abs(number) < 2**63 else None


def _moment(text: object) -> datetime | None:
    try:
        moment = datetime.fromisoformat(str(text))
    except ValueError:
        return None
    return moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)


def _truth(value: object) -> bool | None:
    return value if isinstance(value, bool) else None


def _texts(value: object) -> list[str]:
    return [str(text) for text in value] if isinstance(value, list) else []


_KINDS: Mapping[Kind, tuple[dict[str, object], Callable[[object], Cell]]] = {
    "text": ({"type": ["string", "null"]}, str),
    "texts": ({"type": "array", "items": {"type": "string"}}, _texts),
    "integer": ({"type": ["integer", "null"]}, _whole),
    "number": ({"type": ["number", "null"]}, _finite),
    "truth": ({"type": ["boolean", "null"]}, _truth),
    "moment": ({"type": ["string", "null"], "format": "date-time"}, _moment),
}
"""Type in the JSON Schema of each kind, and what makes a value fit it."""
