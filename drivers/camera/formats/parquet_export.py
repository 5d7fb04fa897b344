"""Write events to a Parquet file, for pandas, Polars, DuckDB and other programs that read tables.

Columns: ``t`` (int64, us: the sensor's clock), ``x``, ``y`` (uint16, px), ``p`` (uint8: 1 ON, 0 OFF). The schema's
metadata hold ``width``, ``height``, the keys of the header as JSON (``header``), and the trigger edges as JSON of
``t``, ``value`` and ``id`` (``triggers``).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from drivers.camera.event_arrays import Events, EventSource, Triggers
from drivers.errors import CameraSoftwareMissing, RecordingFileError

GROUP_EVENTS: Final = 1 << 20
"""Number of events in a row group; DuckDB and Polars read groups of this size on all processors."""
MOST_EDGES: Final = 100_000
"""Most edges: they are 2 MB of the metadata, which every reader loads first."""
_ENCODINGS: Final = {
    "t": "DELTA_BINARY_PACKED",
    "x": "BYTE_STREAM_SPLIT",
    "y": "BYTE_STREAM_SPLIT",
    "p": "BYTE_STREAM_SPLIT",
}
"""Encodings of the columns: with LZ4, a third of the time and of the bytes of pyarrow's own choice."""


def require_pyarrow() -> Any:
    """Load pyarrow. Raises CameraSoftwareMissing if it is not installed."""
    try:
        import pyarrow as pa
        import pyarrow.parquet
    except ImportError as error:
        raise CameraSoftwareMissing(
            "A Parquet file needs pyarrow, which is not installed.",
            remedy="Install it: pip install 'starbench[table]'",
        ) from error
    return pa


def write_parquet(
    part: Path, source: EventSource, chunks: Iterator[Events], triggers: Callable[[], Triggers]
) -> None:
    """Write chunks of events to a new file, in a thread beside their decoding; ``triggers`` is called at the end.

    Raises `RecordingFileError` if there are too many edges.
    """
    pa = require_pyarrow()
    kinds = {"t": pa.int64(), "x": pa.uint16(), "y": pa.uint16(), "p": pa.uint8()}
    schema = pa.schema([pa.field(name, kind, nullable=False) for name, kind in kinds.items()])
    options = {"compression": "lz4", "use_dictionary": False, "write_statistics": ["t"]}
    with (
        pa.parquet.ParquetWriter(part, schema, column_encoding=_ENCODINGS, **options) as writer,
        ThreadPoolExecutor(max_workers=1) as pool,
    ):
        before = None
        for chunk in chunks:
            batch = pa.record_batch(list(chunk), schema=schema)
            if before is not None:
                before.result()
            before = pool.submit(writer.write_batch, batch, row_group_size=GROUP_EVENTS)
        if before is not None:
            before.result()
        writer.add_key_value_metadata(_metadata(source, triggers(), part))


def _metadata(source: EventSource, edges: Triggers, path: Path) -> Mapping[str, str]:
    if len(edges.t) > MOST_EDGES:
        raise RecordingFileError(
            f"A Parquet file of events holds at most {MOST_EDGES} trigger edges; here are {len(edges.t)}.",
            where=str(path),
            remedy="Write HDF5 (.h5) or .npz.",
        )
    return {
        "width": str(source.width),
        "height": str(source.height),
        "header": json.dumps(dict(source.header)),
        "triggers": json.dumps({name: values.tolist() for name, values in edges._asdict().items()}),
    }
