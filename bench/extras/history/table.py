"""Write the table of runs as Parquet (pyarrow, extra ``table``) or CSV, some hundred rows at a time to spare memory."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

from bench.base.entry_points import extra_library
from bench.base.errors import UsageError
from bench.extras.history.columns import COLUMNS, SCHEMA, Cell, Row
from bench.record.storage import new_output, require_free, storage_errors

ROWS_AT_ONCE = 500  # Rows in memory, and in a group of a Parquet file
ENDINGS = (".parquet", ".csv")
_INSTALL = (
    "Install it: pip install 'starbench[table]'. Or name a file that ends in .csv, which needs nothing."
)
_FORMULA = tuple("=+-@\t\r\n\uff1d\uff0b\uff0d\uff20")
"""A spreadsheet takes text that begins with one of these for a formula; the last four are = + - @ of full width (OWASP,
CSV injection)."""


def require_ending(path: Path, endings: Sequence[str]) -> None:
    """Refuse a name for a file of some kinds that ends otherwise."""
    if path.suffix.lower() not in endings:
        what = f"The ending {path.suffix} is not supported." if path.suffix else "The name has no ending."
        remedy = f"Choose a name that ends in {' or '.join(endings)}."
        raise UsageError(what, where=str(path), remedy=remedy)


def require_writable_table(path: Path) -> None:
    """Refuse a name or a place at which no table can be written, before any work begins."""
    require_ending(path, ENDINGS)
    require_free(path)
    if path.suffix.lower() == ".parquet":
        _pyarrow()


def write_table(path: Path, rows: Iterable[Row], faults: Sequence[str] = ()) -> int:
    """Write a new table, and return its number of rows; Parquet keeps ``faults`` of the merging in its metadata."""
    require_writable_table(path)
    with new_output(path) as part, storage_errors(path):
        if path.suffix.lower() == ".csv":
            return _write_csv(part, rows)
        return _write_parquet(part, rows, arrow_schema(faults))


def _pyarrow() -> Any:
    what = "A Parquet file needs pyarrow, which is not installed."
    extra_library("pyarrow.parquet", what, remedy=_INSTALL)
    return extra_library("pyarrow", what, remedy=_INSTALL)


def arrow_schema(faults: Sequence[str]) -> Any:
    """Return the Parquet schema: each column's unit and meaning, ``starbench_schema`` and ``starbench_faults``."""
    pa = _pyarrow()
    kinds = {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "integer": pa.int64(),
        "number": pa.float64(),
        "truth": pa.bool_(),
        "moment": pa.timestamp("us", tz="UTC"),
    }
    fields = [
        pa.field(
            column.name,
            kinds[column.kind],
            metadata={"unit": column.unit, "meaning": column.meaning.replace("`", "")},
        )
        for column in COLUMNS
    ]
    return pa.schema(
        fields, metadata={"starbench_schema": SCHEMA, "starbench_faults": json.dumps(list(faults))}
    )


def _write_parquet(path: Path, rows: Iterable[Row], schema: Any) -> int:
    pa, waiting, count = _pyarrow(), iter(rows), 0
    with pa.parquet.ParquetWriter(path, schema, compression="zstd") as writer:
        while block := list(islice(waiting, ROWS_AT_ONCE)):
            writer.write_table(pa.Table.from_pylist(block, schema=schema))
            count += len(block)
    return count


def _write_csv(path: Path, rows: Iterable[Row]) -> int:
    count = 0
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\r\n")  # RFC 4180; a CR within a text is then quoted, too
        writer.writerow([column.name for column in COLUMNS])
        for row in rows:
            writer.writerow([_cell(row[column.name]) for column in COLUMNS])
            count += 1
    return count


def _cell(value: Cell) -> str:
    """Return a value as a cell; text that a spreadsheet would calculate begins with an apostrophe."""
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.isoformat().replace("+00:00", "Z")
    if isinstance(value, list):
        return json.dumps(value, ensure_ascii=False)
    return repr(value) if isinstance(value, float) else str(value)
