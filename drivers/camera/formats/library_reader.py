"""Read files of other programs through their libraries: the program of the process that `library_process` starts.

    python -m drivers.camera.formats.library_reader KIND PATH CHOICES

It limits its own memory first. The file is read twice: once to count the events and to collect the edges; and its
events are written as messages.

- Tables of NumPy, of Parquet and of text (`table_files`).
- HDF5 that only its library can read, with the filters of the package ``hdf5plugin``.
- What a package brings: then KIND is ``module:function``.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from drivers.camera.event_arrays import (
    Events,
    EventSource,
    ReadingChoices,
    Triggers,
    empty_events,
    empty_triggers,
)
from drivers.camera.formats import library_process
from drivers.camera.formats.table_files import from_npy, from_npz, from_parquet, from_text
from drivers.errors import CameraSoftwareMissing, DriverError, RecordingCorrupt, UnreadableEvents

_PIECE: Final = 500_000  # Events


def main(kind: str, path: Path, choices: ReadingChoices) -> None:
    """Read a file and write the messages; the last one says that it is the end, or what is wrong."""
    _limit_memory()
    try:
        of_tables = {"npz": from_npz, "npy": from_npy, "parquet": from_parquet, "text": from_text}
        own = {**of_tables, "hdf5": _from_hdf5}
        source = (own.get(kind) or _brought(kind))(path, choices)
        facts = {name: getattr(source, name) for name in ("count", "width", "height", "truncated", "unit")}
        _write({**facts, "header": dict(source.header), "assumed": dict(source.assumed)})
        for events, edges in source.pieces():
            for begin in range(0, max(len(events.t), len(edges.t)), _PIECE):
                _write({}, events.part(begin, begin + _PIECE), edges.part(begin, begin + _PIECE))
        _write({"end": True})
    except ModuleNotFoundError as error:
        package = str(error.name).partition(".")[0]
        remedy = f"Install it: pip install {package}"
        _write(
            {"kind": "missing", "error": f"Reading this file needs the package {package}.", "remedy": remedy}
        )
    except CameraSoftwareMissing as error:
        _write({"kind": "missing", "error": error.what, "remedy": error.remedy})
    except RecordingCorrupt as error:
        what = error.what.removesuffix(f" (byte {error.offset}).")  # the reader of this names the place again
        _write({"kind": "corrupt", "error": what, "remedy": error.remedy, "offset": error.offset})
    except DriverError as error:
        # What to do about unreadable events is the same for every reader: the bench says it with the file's name.
        remedy = "" if isinstance(error, UnreadableEvents) else error.remedy
        _write({"kind": "other", "error": error.what, "remedy": remedy})
    except MemoryError:
        _write({"kind": "memory"})
    except BaseException:  # a panic of compiled code is no Exception
        _write({"kind": "unreadable"})
        raise


def _brought(kind: str) -> Callable[[Path, ReadingChoices], EventSource]:
    module, _, name = kind.partition(":")
    return cast("Callable[[Path, ReadingChoices], EventSource]", getattr(import_module(module), name))


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = (
        library_process.MOST_BYTES
        if hard == resource.RLIM_INFINITY
        else min(library_process.MOST_BYTES, hard)
    )
    resource.setrlimit(resource.RLIMIT_AS, (most, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _write(text: Mapping[str, Any], events: Events | None = None, triggers: Triggers | None = None) -> None:
    events, triggers = events or empty_events(0), triggers or empty_triggers(0)
    encoded = json.dumps(text).encode()
    out = sys.stdout.buffer
    out.write(library_process.HEAD.pack(len(encoded), len(events.t), len(triggers.t)) + encoded)
    for array in (*events, *triggers):
        out.write(np.ascontiguousarray(array).tobytes())
    out.flush()


def _from_hdf5(path: Path, choices: ReadingChoices) -> EventSource:
    import h5py

    from drivers.camera.formats.hdf5_events import opened_hdf5

    with suppress(ImportError):
        import hdf5plugin  # noqa: F401 - registers the filters
    source = opened_hdf5(h5py.File(path, "r"), choices, by_library=True)
    assert source is not None
    return source


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), ReadingChoices.from_json(json.loads(sys.argv[3])))
