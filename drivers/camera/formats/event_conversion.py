"""One file of events to another: RAW, Metavision's HDF5, plain HDF5, NumPy; every way between them.

A RAW file made here is no camera's own bytes, and its header says so. What is read of other files is in memory whole
(13 bytes an event), RAW files are streamed but for NumPy's. What a format cannot hold is lost on the way
there: the sensor's counters outside RAW, its clock's back-steps in Metavision's HDF5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final, Literal, get_args

import numpy as np

from drivers.camera import CameraIdentity
from drivers.camera.evt3 import Triggers, empty_events
from drivers.camera.formats.event_files import Exported, export_hdf5, export_metavision, export_numpy
from drivers.camera.formats.event_import import Imported, import_events
from drivers.camera.formats.evt3_encode import Evt3Encoder
from drivers.camera.formats.new_file import cannot_write, new_file
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_header import MAX_SIDE_PX, render_header
from drivers.errors import NotARecording, RecordingFileError

Kind = Literal["raw", "metavision", "hdf5", "numpy"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

_BY_ENDING: Final[Mapping[str, Kind]] = {
    ".raw": "raw",
    ".hdf5": "metavision",
    ".h5": "hdf5",
    ".npz": "numpy",
}
_AT_ONCE: Final = 1_000_000


def kind_of_name(path: Path) -> Kind | None:
    """Say which kind a file's name stands for: Metavision writes ``.hdf5``, others ``.h5``; None for no such name.

    Examples
    --------
    >>> [kind_of_name(Path(name)) for name in ("a.raw", "a.hdf5", "a.h5", "a.npz", "a.csv")]
    ['raw', 'metavision', 'hdf5', 'numpy', None]
    """
    return _BY_ENDING.get(path.suffix.lower())


def convert(source: Path, target: Path, kind: Kind, *, utc_now: Callable[[], datetime]) -> Exported:
    """Write the events and triggers of a file, told by what it holds, as a new file of that kind.

    Parameters
    ----------
    source, target
        The files; ``target`` appears whole or not at all.
    kind
        Of the new file.
    utc_now
        Tells the time that the header of a new RAW file states, where the source has none.

    Raises
    ------
    NotARecording, RecordingCorrupt, RecordingFileError
        When the source cannot be read, the target exists or cannot be written, or EVT3 cannot hold what is in it.
    """
    if _is_raw(source):
        if kind == "raw":
            raise NotARecording(
                "It is a RAW recording already.", where=str(source), remedy="Name another kind of file."
            )
        return _EXPORTS[kind](RawFile.open(source), target)
    found = import_events(source)
    if kind == "raw":
        return write_raw(found, target, source=source, utc_now=utc_now)
    with _folder_beside(target) as folder:
        between = Path(folder) / "between.raw"
        moved = write_raw(found, between, source=source, utc_now=utc_now).moved_events
        written = _EXPORTS[kind](RawFile.open(between), target)
        return replace(written, moved_events=written.moved_events + moved)


def write_raw(found: Imported, path: Path, *, source: Path, utc_now: Callable[[], datetime]) -> Exported:
    """Write events as a new RAW file of EVT3, whose header names where they come from.

    Raises
    ------
    RecordingFileError
        When the file exists or cannot be written, or EVT3 cannot hold the sensor's size, times or triggers.
    """
    if not all(0 < side <= MAX_SIDE_PX for side in (found.width, found.height)):
        raise RecordingFileError(
            f"EVT3 cannot hold it: a sensor of {found.width} x {found.height} px.",
            where=str(source),
            remedy=f"Sides are 1 to {MAX_SIDE_PX} px.",
        )
    encoder = Evt3Encoder()
    events, triggers = found.events, found.triggers
    with new_file(path) as part, part.open("xb") as file:
        file.write(_header(found, source, utc_now))
        done, latest = 0, -1
        try:
            for begin in range(0, len(events.t), _AT_ONCE):
                piece = events.part(begin, begin + _AT_ONCE)
                latest = max(latest, int(piece.t.max()))
                until = int(np.searchsorted(triggers.t, latest, "right"))
                file.write(encoder.words(piece, _edges(triggers, done, until)).tobytes())
                done = max(done, until)
            file.write(encoder.words(empty_events(0), _edges(triggers, done, len(triggers.t))).tobytes())
        except ValueError as error:
            raise RecordingFileError(
                f"EVT3 cannot hold it: {error}.",
                where=str(source),
                remedy="Let its times begin near 0, and edges be 0 or 1.",
            ) from error
    return Exported(len(events.t), len(triggers.t), encoder.moved)


_EXPORTS: Final = {"metavision": export_metavision, "hdf5": export_hdf5, "numpy": export_numpy}


def _folder_beside(target: Path) -> TemporaryDirectory[str]:
    """Make a folder on the target's own disk. Raises RecordingFileError."""
    try:
        return TemporaryDirectory(prefix=".starbench-", dir=target.parent)
    except OSError as error:
        raise cannot_write(target, error) from error


def _is_raw(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(2) == b"% "
    except OSError:
        return False  # whoever reads it next says why


def _edges(triggers: Triggers, begin: int, end: int) -> Triggers:
    return Triggers(triggers.t[begin:end], triggers.value[begin:end], triggers.id[begin:end])


def _header(found: Imported, source: Path, utc_now: Callable[[], datetime]) -> bytes:
    said = found.header
    camera = CameraIdentity(
        maker=said.get("integrator_name", ""),
        model="",
        sensor=said.get("sensor_name", ""),
        serial=said.get("serial_number", ""),
        firmware="",
        width=found.width,
        height=found.height,
    )
    try:
        recorded_at = datetime.strptime(said.get("date", ""), "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        recorded_at = utc_now()
    origin = f"% converted_from {' '.join(source.name.split())}; not the bytes of a camera\n% end\n"
    # at the end alone: a serial number may hold these words too
    return render_header(camera, recorded_at).removesuffix(b"% end\n") + origin.encode("ascii", "replace")
