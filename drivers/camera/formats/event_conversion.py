"""Convert a file of events to another format: RAW, Metavision's HDF5, plain HDF5, NumPy; each to each.

Files of other programs are read too: EVT2, DAT, AEDAT4, ROS bags.
A RAW file made here does not hold a camera's own bytes, and its header says so. All files are read piece by piece; only
for a new NumPy file all events are in memory. What the new format cannot represent is lost: the sensor's counters
outside RAW, back-steps of its clock in Metavision's HDF5.
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
from drivers.camera.event_arrays import Triggers, empty_events
from drivers.camera.formats.event_files import ExportSummary, export_hdf5, export_metavision, export_numpy
from drivers.camera.formats.event_import import open_events
from drivers.camera.formats.event_source import EventSource
from drivers.camera.formats.evt3_encode import Evt3Encoder
from drivers.camera.formats.prophesee_words import header_fields, is_dat, is_evt2
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_header import MAX_HEADER_BYTES, MAX_SIDE_PX, render_header
from drivers.camera.raw_writer import new_file, write_error
from drivers.camera.whole_file import require_regular
from drivers.errors import NotARecording, RecordingFileError

Kind = Literal["raw", "metavision", "hdf5", "numpy"]
KINDS: Final[tuple[Kind, ...]] = get_args(Kind)

_BY_ENDING: Final[Mapping[str, Kind]] = {
    ".raw": "raw",
    ".hdf5": "metavision",
    ".h5": "hdf5",
    ".npz": "numpy",
}


def kind_of_name(path: Path) -> Kind | None:
    """Return the kind of file that a name stands for: Metavision writes ``.hdf5``, others ``.h5``.

    Returns: The kind; None if the ending is not known.

    Examples
    --------
    >>> [kind_of_name(Path(name)) for name in ("a.raw", "a.hdf5", "a.h5", "a.npz", "a.csv")]
    ['raw', 'metavision', 'hdf5', 'numpy', None]
    """
    return _BY_ENDING.get(path.suffix.lower())


def convert(source: Path, target: Path, kind: Kind, *, utc_now: Callable[[], datetime]) -> ExportSummary:
    """Write the events and triggers of a file as a new file of another kind.

    source: The file to read; its contents decide its kind, not its name.
    target: The file to make; it must not exist, and appears complete or not at all.
    utc_now: Returns the time for the header of a new RAW file, if the source states none.
    Raises NotARecording: If the source holds no events, or both files would be RAW.
    Raises RecordingCorrupt: If the source is damaged.
    Raises RecordingFileError: If the source cannot be read, the target exists or cannot be written, or EVT3
      cannot represent the contents.
    """
    if is_evt3(source):
        if kind == "raw":
            raise NotARecording(
                "The file is a RAW recording already.",
                where=str(source),
                remedy="Choose another kind of file.",
            )
        return _EXPORTS[kind](RawFile.open(source), target)
    if kind == "raw":
        with open_events(source) as found:
            return write_raw(found, target, source=source, utc_now=utc_now)
    with _folder_beside(target) as folder:
        between = Path(folder) / "between.raw"
        with open_events(source) as found:
            moved = write_raw(found, between, source=source, utc_now=utc_now).moved_events
        written = _EXPORTS[kind](RawFile.open(between), target)
        return replace(written, moved_events=written.moved_events + moved)


def write_raw(
    found: EventSource, path: Path, *, source: Path, utc_now: Callable[[], datetime]
) -> ExportSummary:
    """Write events as a new RAW file of EVT3. Its header names the source.

    path: The file to make; it must not exist.
    utc_now: Returns the time for the header, if the source states none.
    Raises RecordingFileError: If the file exists or cannot be written, or EVT3 cannot represent the sensor's
      size, times or triggers.
    """
    if not all(0 < side <= MAX_SIDE_PX for side in (found.width, found.height)):
        raise RecordingFileError(
            f"EVT3 cannot represent a sensor of {found.width} x {found.height} px.",
            where=str(source),
            remedy=f"Convert files of sensors with sides of 1 to {MAX_SIDE_PX} px only.",
        )
    encoder = Evt3Encoder()
    triggers, count = found.triggers, 0
    with new_file(path) as part, part.open("xb") as file:
        file.write(_header(found, source, utc_now))
        done, latest = 0, -1
        try:
            for piece in found.pieces():
                if not len(piece.t):
                    continue
                count += len(piece.t)
                latest = max(latest, int(piece.t.max()))
                until = int(np.searchsorted(triggers.t, latest, "right"))
                file.write(encoder.words(piece, _edges(triggers, done, until)).tobytes())
                done = max(done, until)
            file.write(encoder.words(empty_events(0), _edges(triggers, done, len(triggers.t))).tobytes())
        except ValueError as error:
            raise RecordingFileError(
                f"EVT3 cannot represent the file: {error}.",
                where=str(source),
                remedy="Change its values: times from 0 to one day, trigger values 0 or 1, trigger ids 0 to 15.",
            ) from error
    return ExportSummary(count, len(triggers.t), encoder.moved_events)


_EXPORTS: Final = {"metavision": export_metavision, "hdf5": export_hdf5, "numpy": export_numpy}


def _folder_beside(target: Path) -> TemporaryDirectory[str]:
    """Make a temporary folder on the target's own disk. Raises RecordingFileError."""
    try:
        return TemporaryDirectory(prefix=".starbench-", dir=target.parent)
    except OSError as error:
        raise write_error(target, error) from error


def is_evt3(path: Path) -> bool:
    """Return whether a file is a RAW recording with EVT3 words, or pretends to be one.

    Returns: False too where it cannot be read.
    """
    try:
        require_regular(path)
        with path.open("rb") as file:
            start = file.read(MAX_HEADER_BYTES)
        fields = header_fields(start)[0]
    except (OSError, ValueError):
        return False  # open_events reports the reason
    return start.startswith(b"% ") and not is_dat(start) and not is_evt2(fields)


def _edges(triggers: Triggers, begin: int, end: int) -> Triggers:
    return Triggers(triggers.t[begin:end], triggers.value[begin:end], triggers.id[begin:end])


def _header(found: EventSource, source: Path, utc_now: Callable[[], datetime]) -> bytes:
    header = found.header
    camera = CameraIdentity(
        maker=header.get("integrator_name", ""),
        model="",
        sensor=header.get("sensor_name", ""),
        serial=header.get("serial_number", ""),
        firmware="",
        width=found.width,
        height=found.height,
    )
    try:
        recorded_at = datetime.strptime(header.get("date", ""), "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        recorded_at = utc_now()
    origin = f"% converted_from {' '.join(source.name.split())}; not the bytes of a camera\n% end\n"
    # only at the end: a serial number may hold these characters too
    return render_header(camera, recorded_at).removesuffix(b"% end\n") + origin.encode("ascii", "replace")
