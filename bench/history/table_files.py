"""Write the table of runs as Parquet or CSV, some hundred rows at a time, so that memory does not grow with the runs.

Parquet needs pyarrow, from the extra ``table``. A file appears under its name when it is complete.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from datetime import datetime
from itertools import islice
from pathlib import Path
from typing import Any

from bench.base.errors import UsageError
from bench.history.table_schema import COLUMNS, SCHEMA, Column
from bench.records.storage import move_into_place, storage_errors

ROWS_AT_ONCE = 500
ENDINGS = (".parquet", ".csv")
_INSTALL = (
    "Install it: pip install 'starbench[table]'. Or name a file that ends in .csv, which needs nothing."
)

Row = Mapping[str, Any]


def require_writable_table(path: Path) -> None:
    """Refuse a name or a place at which no table can be written, before any work begins.

    Raises UsageError: If the ending is not known, pyarrow is missing, or the folder does not exist.
    """
    if path.suffix.lower() not in ENDINGS:
        raise UsageError(
            f"The table can be written as Parquet or CSV, not as {path.suffix or 'a file without an ending'}.",
            where=str(path),
            remedy="Choose a name that ends in .parquet or .csv.",
        )
    if path.is_dir() or not path.absolute().parent.is_dir():
        what = "This is a folder, not a file." if path.is_dir() else "The folder of this file does not exist."
        raise UsageError(what, where=str(path), remedy="Choose another name.")
    if path.suffix.lower() == ".parquet":
        _pyarrow()


def write_table(path: Path, rows: Iterable[Row], faults: Sequence[str] = ()) -> int:
    """Write the table. A file of that name is replaced.

    rows: Rows, as `bench.history.table_rows.table_row` makes them.
    faults: What was noticed when the runs were merged; Parquet keeps it in the metadata of the file.
    Raises UsageError: As `require_writable_table`.
    Raises StorageError: When the file cannot be written.
    """
    require_writable_table(path)
    part = path.with_name(f".{path.name}.part")
    write = _write_csv if path.suffix.lower() == ".csv" else _parquet_writer(faults)
    with storage_errors(path):
        try:
            count = write(part, rows)
            move_into_place(part, path)
        finally:
            part.unlink(missing_ok=True)
    return count


def _pyarrow() -> Any:
    try:
        import pyarrow as pa
        import pyarrow.parquet
    except ImportError as error:
        raise UsageError("A Parquet file needs pyarrow, which is not installed.", remedy=_INSTALL) from error
    return pa


def _arrow_type(pa: Any, column: Column) -> Any:
    kinds = {
        "text": pa.string(),
        "texts": pa.list_(pa.string()),
        "integer": pa.int64(),
        "number": pa.float64(),
        "truth": pa.bool_(),
        "moment": pa.timestamp("us", tz="UTC"),
    }
    return kinds[column.kind]


def arrow_schema(faults: Sequence[str] = ()) -> Any:
    """Return the schema of the Parquet file.

    Returns: With ``starbench_schema`` and ``starbench_faults`` in its metadata, and unit and meaning of each
      column.
    Raises UsageError: If pyarrow is missing.
    """
    pa = _pyarrow()
    fields = [
        pa.field(
            column.name,
            _arrow_type(pa, column),
            metadata={"unit": column.unit, "meaning": column.meaning.replace("`", "")},
        )
        for column in COLUMNS
    ]
    return pa.schema(
        fields, metadata={"starbench_schema": SCHEMA, "starbench_faults": json.dumps(list(faults))}
    )


def _parquet_writer(faults: Sequence[str]) -> Callable[[Path, Iterable[Row]], int]:
    def write(path: Path, rows: Iterable[Row]) -> int:
        pa = _pyarrow()
        schema, count = arrow_schema(faults), 0
        with pa.parquet.ParquetWriter(path, schema, compression="zstd") as writer:
            for block in _blocks(rows):
                writer.write_table(pa.Table.from_pylist(block, schema=schema))
                count += len(block)
        return count

    return write


def _blocks(rows: Iterable[Row]) -> Iterator[list[Row]]:
    waiting = iter(rows)
    while block := list(islice(waiting, ROWS_AT_ONCE)):
        yield block


def _write_csv(path: Path, rows: Iterable[Row]) -> int:
    count = 0
    with path.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([column.name for column in COLUMNS])
        for row in rows:
            writer.writerow([_cell(row[column.name]) for column in COLUMNS])
            count += 1
    return count


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, datetime):
        return value.isoformat().replace("+00:00", "Z")
    if isinstance(value, list):
        return json.dumps(value, ensure_ascii=False)
    return repr(value) if isinstance(value, float) else str(value)
