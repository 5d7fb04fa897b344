"""The program of the process that `library_process` starts: it reads one file, and writes what it finds as messages.

    python -m drivers.camera.formats.library_reader KIND PATH

It limits its own memory first. The file is read twice: once to count the events and to collect the edges.
"""

from __future__ import annotations

import json
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from drivers.camera.event_arrays import Events, Triggers, empty_events, empty_triggers
from drivers.camera.formats import library_process
from drivers.camera.formats.event_source import (
    EventSource,
    Piece,
    as_events,
    as_triggers,
    require_one_length,
    require_ratio,
    source_of_stream,
)
from drivers.errors import CameraSoftwareMissing, DriverError, RecordingCorrupt

_PIECE: Final = 500_000
_NAMES: Final = ("t", "x", "y", "p")
_EDGE_NAMES: Final = ("t", "value", "id")
_NAMED: Final = {"npz": "NumPy file", "aedat4": "AEDAT4 file", "bag": "ROS bag"}


def main(kind: str, path: Path) -> None:
    """Read a file and write the messages; the last one says that it is the end, or what is wrong."""
    _limit_memory()
    try:
        source = _open(kind, path)
        for begin in range(0, len(source.triggers.t), _PIECE):
            place = slice(begin, begin + _PIECE)
            t, value, channel = source.triggers
            _write({}, triggers=Triggers(t[place], value[place], channel[place]))
        size = {"count": source.count, "width": source.width, "height": source.height}
        _write({**size, "header": dict(source.header)})
        for events in source.pieces():
            for begin in range(0, len(events.t), _PIECE):
                _write({}, events.part(begin, begin + _PIECE))
        _write({"end": True})
    except CameraSoftwareMissing as error:
        _write({"kind": "missing", "error": error.what, "remedy": error.remedy})
    except RecordingCorrupt as error:
        _write({"kind": "corrupt", "error": error.what, "remedy": error.remedy, "offset": error.offset})
    except DriverError as error:
        _write({"kind": "other", "error": error.what, "remedy": error.remedy})
    except MemoryError:
        _write({"kind": "memory"})
    except ValueError as error:
        _write({"kind": "unreadable", "error": " ".join(str(error).split())[:300]})
    except BaseException as error:  # a panic of compiled code is no Exception
        why = " ".join(str(error).split())[:200]
        _write({"kind": "unreadable", "error": f"it is no readable {_NAMED[kind]} ({why})"})
        raise


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


def _open(kind: str, path: Path) -> EventSource:
    if kind == "npz":
        return _from_npz(path)
    if kind == "aedat4":
        from drivers.camera.formats.aedat4 import from_aedat4

        return from_aedat4(path)
    from drivers.camera.formats.ros_bags import from_bag

    return from_bag(path)


def _write(text: Mapping[str, Any], events: Events | None = None, triggers: Triggers | None = None) -> None:
    events, triggers = events or empty_events(0), triggers or empty_triggers(0)
    told = json.dumps(text).encode()
    out = sys.stdout.buffer
    out.write(library_process.HEAD.pack(len(told), len(events.t), len(triggers.t)) + told)
    for array in (*events, *triggers):
        out.write(np.ascontiguousarray(array).tobytes())
    out.flush()


def _from_npz(path: Path) -> EventSource:
    """Open NumPy's ``.npz``, as `event_files` writes it. Only plain numbers are read."""
    with zipfile.ZipFile(path) as archive:
        require_ratio(sum(one.file_size for one in archive.infolist()), path.stat().st_size, "it")
    with np.load(path, allow_pickle=False) as file:
        width, height = (int(side) for side in _array(file, "size"))
        columns = {name: _array(file, name) for name in _NAMES}
        require_one_length({name: len(column) for name, column in columns.items()})
        events = as_events(**columns)
        triggers = as_triggers({name: _array(file, f"trigger_{name}") for name in _EDGE_NAMES})

    def stream() -> Iterator[Piece]:
        yield events, triggers

    return source_of_stream(stream, (width, height), {})


def _array(file: Mapping[str, Any], name: str) -> Any:
    if name not in file:
        raise ValueError(f"{name} is missing")
    return file[name]


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
