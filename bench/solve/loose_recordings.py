"""Recordings that are of no run: what is used of long ones and of those that were cut, and how that is told."""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

RECORDINGS = {".raw"}
MOST_EVENTS = 50_000_000
"""Events of a recording that are used: a second of a bright target, in 1.5 GB of memory. A run records two periods."""
_MOST_NAMED = 5  # What fits on two lines of a terminal
_PART_BYTES = 1 << 20  # Copied at a time, so that a long recording takes little memory


@contextmanager
def used_part(path: Path) -> Iterator[Path]:
    """Yield a RAW file of EVT3 words itself, or a file with its first events if it has more than `MOST_EVENTS`."""
    used = _used_bytes(path)
    if used == path.stat().st_size:
        yield path
        return
    with TemporaryDirectory(prefix="starbench-") as folder:
        begin = Path(folder) / path.name
        with path.open("rb") as whole, begin.open("wb") as file:
            while part := whole.read(min(_PART_BYTES, used - file.tell())):
                file.write(part)
        yield begin


def used_recordings(paths: Iterable[Path], in_pieces: Container[Path] = ()) -> list[str]:
    """Return a sentence on the RAW files that end within a word, and on those of which only the begin is used.

    Files that are read ``in_pieces`` are used whole, however long they are.
    """
    from drivers.camera.raw_check import ends_within_word
    from drivers.camera.raw_file import is_recording

    files = [path for path in dict.fromkeys(paths) if path.suffix.lower() in RECORDINGS]
    cut = [str(path) for path in files if ends_within_word(path)]
    may_be_long = [path for path in files if path not in in_pieces and is_recording(path)]
    shares = {path: _used_bytes(path) / path.stat().st_size for path in may_be_long}
    long = [f"{path} ({share:.0%})" for path, share in shares.items() if share < 1.0]
    begin = f"Of long recordings, the first {MOST_EVENTS // 1_000_000} million events are used"
    sentences = {"Cut in the middle of a word, and used up to there": cut, begin: long}
    return [f"{sentence}: {first_names(names)}." for sentence, names in sentences.items() if names]


def camera_serial(path: Path) -> str:
    """Return the serial number of the camera by the header of a RAW file; empty if none is there."""
    from drivers.camera.raw_check import read_start
    from drivers.camera.raw_header import header_fields

    fields, _ = header_fields(read_start(path))
    return fields.get("serial_number", "")


def _used_bytes(path: Path) -> int:
    from drivers.camera.raw_file import RawFile

    return RawFile.open(path).bytes_of(MOST_EVENTS)


def first_names(names: Sequence[str]) -> str:
    """Return the first names, and the number of the others."""
    more = len(names) - _MOST_NAMED
    return ", ".join(names[:_MOST_NAMED]) + (f" and {more} more" if more > 0 else "")
