"""Sources of views, known by content or extension: run folders, RAW, photographs, point files. Writes none."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from bench.base.compiled_loops import STARS, compile_loops
from bench.base.errors import BenchError, StorageError, UsageError
from bench.base.pasteable import pasteable
from bench.measure.expected_grid import grid_from_journal
from bench.plan.job import Job
from bench.record.events import RunStarted
from bench.record.history import Attempt
from bench.record.run_folder import JOURNAL
from bench.record.stored_run import StoredRun
from bench.solve.loose_recordings import MOST_EVENTS, RECORDINGS, first_names, used_part
from bench.solve.offline_options import OfflineOptions
from bench.solve.point_files import read_point_file
from calib.boards.board import Board
from calib.errors import InputMismatch, TargetNotFound, TooFewStars
from calib.view import View
from drivers.camera.file_kinds import in_place_of_file, kind_of_file, unread_picture
from drivers.errors import DriverError, RecordingCorrupt, RecordingFileError
from sequences.script import RecordStep

if TYPE_CHECKING:  # what finds stars is loaded where stars are found: views may be kept from before
    from bench.measure.measure import ExpectedGrid, Measurement
    from bench.measure.moving_recording import MovingRecording

PHOTOGRAPHS = {".png", ".jpg", ".jpeg", ".jfif", ".tif", ".tiff", ".bmp", ".pgm", ".ppm"}
POINTS = {".txt", ".csv"}
OTHER_RECORDINGS = {".dat", ".aedat4", ".bag", ".db3", ".mcap", ".hdf5", ".h5", ".npz", ".npy", ".parquet"}
_MOST_NAMED = 5  # What fits on two lines of a terminal
_START_BYTES = 64  # Magic numbers are shorter
_GIVE_PICTURE = "Give PNG, TIFF, JPEG or BMP."
_KNOWN = RECORDINGS | OTHER_RECORDINGS | PHOTOGRAPHS | POINTS
_READ_BY_OTHERS = {".aedat4", ".bag", ".db3", ".mcap"}
"""Recordings that a package of others reads, whose version does not show in that of the detector."""
_NOT_FOR_STARS = {"number", "where", "path", "pose", "attempts", "backoff_s", "on_failure", "hold_s", "gates"}
"""Fields of a step that do not decide which stars are found."""
_JPEG = {".jpg", ".jpeg", ".jfif"}
_LARGEST_JPEG_BYTES = 100_000_000  # 100 Mpx in best quality
_JPEG_BEGINS, _JPEG_SCAN, _JPEG_ENDS = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"


@dataclass(frozen=True)
class ViewSource:
    """A file from which a view can be made."""

    path: Path
    read: Callable[[], View]
    sized: bool = True  # Whether the size of its image is known
    job: Job | None = None  # Task of the run, if the file is a recording of a run
    started: RunStarted | None = None  # First line of that run's journal
    attempt: Attempt | None = None  # What the journal says about the recording
    # What decides the view besides the bytes of the file, as values that JSON can hold; None for a file whose
    # views are not kept (`bench.measure.kept_views.KeptViews`).
    decided_by: Mapping[str, Any] | None = None
    view_name: str = ""  # Name of its view, if the file gives several; else empty

    @property
    def name(self) -> str:
        """Name of its view: that of the pose, or of the file without its ending."""
        return self.view_name or (self.attempt.pose_name if self.attempt else self.path.stem)


def jobs_of(sources: Iterable[ViewSource]) -> list[Job | None]:
    """Return the tasks of the runs that views are from, each once; None stands for files that are of no run."""
    return list({id(source.job): source.job for source in sources}.values())


def view_sources(path: Path, choices: OfflineOptions) -> Iterator[ViewSource]:
    """List a path's files for views: a run's accepted recordings by pose, another folder's known files by name."""
    if not path.exists():
        raise UsageError("There is no such file or folder.", where=str(path), remedy="Check the path.")
    if path.is_dir() and (path / JOURNAL).is_file():
        if choices.reconstruct_hz is not None:
            raise UsageError(
                "In the recordings of a run the camera stands still, so no picture can be reconstructed.",
                where=str(path),
                remedy="Leave out --reconstruct.",
            )
        yield from _run_sources(path, choices)
    elif path.is_dir() and not is_bag_folder(path):
        files = sorted(filter(_may_be_a_view, path.iterdir()), key=lambda file: natural_order(file.name))
        if not files:
            raise _no_view_in(path)
        for file in files:
            for source in _file_sources(file, choices):
                yield replace(source, read=partial(_read_listed, source))
    else:
        yield from _file_sources(path, choices)


def _may_be_a_view(path: Path) -> bool:
    """Tell whether a file of a folder is tried: macOS keeps a second, hidden file beside each on a foreign disk."""
    return path.suffix.lower() in _KNOWN and not path.name.startswith(".")


def left_beside(path: Path) -> list[str]:
    """Return a sentence on the files of a folder that are not tried; none of a run folder."""
    if not path.is_dir() or (path / JOURNAL).is_file():
        return []
    names = sorted(entry.name for entry in path.iterdir() if entry.is_file() and not _may_be_a_view(entry))
    text = f"{path}: {first_names(names)}: neither recordings nor images nor point files."
    return [f"{text}{_unread_pictures(path)}"] if names else []


def _unread_pictures(folder: Path) -> str:
    """Return a sentence on each kind of pictures and videos of a folder that are not read; empty if there are none."""
    kinds: dict[tuple[str, str], list[str]] = {}
    for path in sorted(folder.iterdir()):
        unread = path.is_file() and not _may_be_a_view(path)
        if unread and (kind := unread_picture(_start(path), path.suffix)):
            kinds.setdefault(kind, []).append(path.name)
    return "".join(f" {names[0]} is {what}. {remedy}" for (what, remedy), names in kinds.items())


def _start(path: Path) -> bytes:
    """Return the first bytes of a file; none if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(_START_BYTES)
    except OSError:
        return b""


def _no_view_in(folder: Path) -> UsageError:
    """Return the error for a folder without views, which says what it has instead."""
    pictures = _unread_pictures(folder).strip()
    inner = sorted(entry.name for entry in folder.iterdir() if entry.is_dir())
    folders = f"Give one of its folders: {', '.join(inner[:_MOST_NAMED])}." if inner else ""
    return UsageError(
        "The folder contains no run, capture, image or point file.",
        where=str(folder),
        remedy=pictures or folders or f"Known file extensions are {', '.join(sorted(_KNOWN))}.",
    )


def _read_listed(source: ViewSource) -> View:
    """Read a file that only stands in the folder that was given: what it lacks as a view does not end the others."""
    try:
        return source.read()
    except (BenchError, DriverError) as error:
        raise InputMismatch(error.what, where=error.where or str(source.path), remedy=error.remedy) from error


def _run_sources(folder: Path, choices: OfflineOptions) -> Iterator[ViewSource]:
    """List the accepted recordings of a run, to be measured with the settings of its own sequence and station."""
    history = StoredRun(folder).history
    job = Job.from_run_folder(folder)
    accepted = history.accepted()
    if not accepted:
        raise BenchError(
            "No recording of this run was accepted.",
            where=str(folder),
            remedy="Give the files of its captures instead.",
        )
    for index, attempt in sorted(accepted.items()):
        path = folder / str(attempt.stored["capture"])
        if choices.board is not None:
            read = partial(_view_of_recording, path, choices)
            yield ViewSource(path, read, decided_by=_decided_by("recording", path, choices))
            continue
        step = job.record_steps[index]
        step = step if choices.image == "auto" else replace(step, image=choices.image)
        read = partial(_view_of_run, job, path, step, grid_from_journal(attempt))
        decided_by = decided_by_run(job, step, attempt)
        yield ViewSource(path, read, job=job, started=history.started, attempt=attempt, decided_by=decided_by)


def decided_by_run(job: Job, step: RecordStep, attempt: Attempt) -> dict[str, Any]:
    """Return what decides the view of a recording of a run."""
    return {
        "kind": f"run, {job.camera_kind.name} camera",
        "name": step.pose.name,
        "recorded": str(attempt.stored["sha256"]),
        "step": {
            field.name: repr(getattr(step, field.name))
            for field in fields(step)
            if field.name not in _NOT_FOR_STARS
        },
        "frequency_hz": job.frequency_hz(step),
        "target": repr(job.target),
        "grid": attempt.measured.get("expected_grid"),
    }


def _decided_by(kind: str, path: Path, choices: OfflineOptions) -> dict[str, Any]:
    """Return what decides the view of a file that is not of a run."""
    return {
        "kind": kind,
        "name": path.stem,
        "image": choices.image,
        "target": repr(choices.target),
        "board": repr(choices.board),
        "image_size": choices.image_size,
        "most_events": MOST_EVENTS,
    }


def refuse_truncated(path: Path) -> None:
    """Refuse an incomplete recording of a run: its size differs from that in the run's journal."""
    size = path.stat().st_size
    run = path.resolve().parent.parent
    name = path.resolve().relative_to(run).as_posix()
    stored = StoredRun(run).captures if (run / JOURNAL).is_file() else {}
    if name in stored and stored[name].size != size:
        raise RecordingCorrupt(
            f"The recording is incomplete: {stored[name].size} bytes were recorded.",
            offset=size,
            where=str(path),
            remedy="Copy it again from its origin, or leave it out.",
        )


def _view_of_run(job: Job, path: Path, step: RecordStep, expected_grid: ExpectedGrid | None) -> View:
    refuse_truncated(path)
    kind, frequency_hz = job.camera_kind, job.frequency_hz(step)
    return _view(kind.measure(path, step, frequency_hz, job.target, expected_grid, motion=False), path)


def _file_sources(path: Path, choices: OfflineOptions) -> Iterator[ViewSource]:
    """List the views of a file: several pictures of a moving camera's recording, one view of any other file."""
    from bench.measure.moving_recording import MovingRecording

    ending = path.suffix.lower()
    if choices.reconstruct_hz is None or choices.board is None or ending not in RECORDINGS | OTHER_RECORDINGS:
        yield _file_source(path, choices)
        return
    if not _is_recording(path):
        raise UsageError(
            "Pictures are reconstructed from RAW files with EVT3 words only.",
            where=str(path),
            remedy=f"Convert it first: {pasteable('convert', path, path.with_name(path.stem + '-evt3.raw'))}",
        )
    refuse_truncated(path)
    moving = MovingRecording(path, choices.reconstruct_hz)
    for number, at_s in enumerate(moving.at_s):
        name = f"{path.stem}-at-{at_s:.3f}s"
        yield ViewSource(path, partial(_view_of_picture, moving, number, name, choices.board), view_name=name)


def _view_of_picture(moving: MovingRecording, number: int, name: str, board: Board) -> View:
    """Reconstruct a picture and find the board in it."""
    from bench.measure.moving_recording import MOVING_REMEDY
    from calib.boards.detect import detect_board

    try:
        picture = moving.picture(number)
        picture.require_motion()
        return detect_board(picture.image, board, name=name)
    except TargetNotFound as error:
        raise TargetNotFound(
            error.what, where=error.where, remedy=f"{error.remedy} {MOVING_REMEDY}"
        ) from error


def _file_source(path: Path, choices: OfflineOptions) -> ViewSource:
    ending = path.suffix.lower()
    if ending in POINTS and not _is_text_of_events(path):
        read = partial(read_point_file, path, image_size=choices.image_size, origin=choices.origin)
        return ViewSource(path, read, sized=choices.image_size is not None)
    if (
        ending in OTHER_RECORDINGS | POINTS
        or path.is_dir()
        or (ending in RECORDINGS and not _is_recording(path))
    ):
        kind, find = f"other {ending}", _view_of_other_recording
    elif ending in RECORDINGS:
        kind, find = "recording", _view_of_recording
    elif ending in PHOTOGRAPHS:
        kind, find = "photograph", _view_of_photograph
    else:
        from drivers.camera.raw_check import read_start

        _require_no_part_of_a_run(path)
        start = read_start(path)
        contents, remedy = kind_of_file(start, ending)
        raise UsageError(
            f"Unknown file extension {ending!r}: the file is {contents}."
            if ending
            else "The file has no extension.",
            where=str(path),
            remedy=remedy or f"Known file extensions are {', '.join(sorted(_KNOWN))}.",
        )
    decided_by = None if ending in _READ_BY_OTHERS or path.is_dir() else _decided_by(kind, path, choices)
    return ViewSource(path, partial(find, path, choices), decided_by=decided_by)


def _require_no_part_of_a_run(path: Path) -> None:
    """Refuse a file of a run that is no recording: its folder is what can be calibrated. Raises UsageError."""
    if (path.parent / JOURNAL).is_file():
        raise UsageError(
            "This is a file of a run, and not a recording of it.",
            where=str(path),
            remedy=f"Name the folder of the run: {path.parent}",
        )


def is_bag_folder(path: Path) -> bool:
    """Return whether a folder is a bag of ROS 2: one recording, not a folder of files."""
    return (path / "metadata.yaml").is_file()


def _is_recording(path: Path) -> bool:
    """Return whether a file is RAW with EVT3 words that states the size of its sensor: it is read as it is."""
    from drivers.camera.raw_file import is_recording

    return is_recording(path)


def _is_text_of_events(path: Path) -> bool:
    """Return whether a file is text with a line for each event: points have five columns, events four.

    False if it cannot be read: then its reader says why.
    """
    from drivers.camera.formats.table_files import is_table_of_text
    from drivers.camera.raw_check import read_start

    try:
        return is_table_of_text(read_start(path))
    except (OSError, RecordingFileError):
        return False


def _view_of_other_recording(path: Path, choices: OfflineOptions) -> View:
    """Read a recording of another program through a RAW file that exists only meanwhile."""
    from drivers.camera.event_arrays import ReadingChoices
    from drivers.camera.formats.event_conversion import convert

    with TemporaryDirectory(prefix="starbench-") as folder:
        raw = Path(folder) / f"{path.stem}.raw"
        convert(path, raw, "raw", ReadingChoices(choices.image_size))
        return _view_of_recording(raw, choices, path)


def _view_of_recording(path: Path, choices: OfflineOptions, shown: Path | None = None) -> View:
    """Find the target in a recording, which messages name ``shown`` if it was made from another file."""
    compile_loops(STARS)
    from bench.measure.measure import measure, recorded_image

    refuse_truncated(path)
    with used_part(path) as begin:
        if choices.board is not None:
            image = recorded_image(begin, choices.image)
            return _detected_board(image, choices.board, shown or path)
        measured = measure(
            begin,
            name=path.stem,
            target=choices.target,
            image=choices.image,
            periods=None,
            expected_hz=None,
            motion=False,
        )
    return _view(measured, shown or path)


def picture_of(path: Path) -> NDArray[Any]:
    """Return the (H, W) picture of a RAW file or a photograph in which a target would be searched."""
    from bench.measure.measure import recorded_image

    ending = path.suffix.lower()
    if ending in PHOTOGRAPHS:
        return _photograph(path)
    if ending not in RECORDINGS:
        raise UsageError(
            "There is no picture in this file: it is neither a RAW recording nor a photograph.",
            where=str(path),
            remedy=f"Known file extensions are {', '.join(sorted(RECORDINGS | PHOTOGRAPHS))}; `starbench convert`"
            " writes RAW files from event files of others.",
        )
    refuse_truncated(path)
    with used_part(path) as begin:
        return recorded_image(begin)


def _view(measurement: Measurement, path: Path) -> View:
    if measurement.view is None:
        raise TooFewStars(measurement.fault, where=str(path))
    return measurement.view


def _photograph(path: Path) -> NDArray[Any]:
    """Read a photograph, in grey."""
    from drivers.camera.frames import mean_frame, require_bounded_images

    try:
        require_bounded_images(path)
        refuse_truncated_jpeg(path)
        return mean_frame(path)
    except RecordingFileError as error:
        what, remedy = _other_contents(path)
        raise BenchError(what or error.what, where=str(path), remedy=remedy or _GIVE_PICTURE) from error


def _other_contents(path: Path) -> tuple[str, str]:
    """Return what a file is that has the ending of a picture and is none, and what to do; else two empty texts."""
    if not path.is_file():
        return "", ""
    start = _start(path)
    what, remedy = unread_picture(start) or in_place_of_file(start) or (kind_of_file(start)[0], "")
    return (f"The file is {what}.", remedy) if remedy or what in {"empty", "a text file"} else ("", "")


def _view_of_photograph(path: Path, choices: OfflineOptions) -> View:
    from calib.stars.detect import detect_view
    from calib.stars.rim import downweight_vignetted

    picture = _photograph(path)
    if choices.board is not None:
        try:
            return _detected_board(picture, choices.board, path)
        except TargetNotFound as error:
            raise TargetNotFound(
                error.what, where=error.where, remedy=f"{error.remedy}{_about_pages(path)}"
            ) from error
    compile_loops(STARS)
    return downweight_vignetted(detect_view(picture, choices.target, name=path.stem), choices.target)


def _about_pages(path: Path) -> str:
    """Return a sentence if a picture is the mean of several pages; empty if it is not."""
    from drivers.camera.frames import image_sizes

    with path.open("rb") as file:
        pages = len(image_sizes(file))
    return (
        f" The picture is the mean of {pages} pages: give a file for each pose of the board."
        if pages > 1
        else ""
    )


def _detected_board(image: NDArray[Any], board: Board, path: Path) -> View:
    """Find a board in an image."""
    from calib.boards.detect import detect_board

    return detect_board(image, board, name=path.stem)


def refuse_truncated_jpeg(path: Path) -> None:
    """Refuse a JPEG without its end marker, because OpenCV fills the missing part with grey."""
    if path.suffix.lower() not in _JPEG:
        return
    try:
        data = path.read_bytes() if path.stat().st_size <= _LARGEST_JPEG_BYTES else b""
    except OSError as error:
        raise StorageError(f"The file cannot be read: {error.strerror}.", where=str(path)) from error
    # Neither marker can occur within coded data; those of a preview come before those of the picture.
    if data.startswith(_JPEG_BEGINS) and data.rfind(_JPEG_ENDS) < data.rfind(_JPEG_SCAN):
        raise RecordingCorrupt(
            "The picture is incomplete.",
            offset=len(data),
            where=str(path),
            remedy="Copy it again, or leave it out.",
        )


def natural_order(name: str) -> list[tuple[int, int, str]]:
    """Return a sort key that puts image10 after image9."""
    words = re.split(r"(\d+)", name)
    return [(0, int(word), "") if word.isdigit() else (1, 0, word) for word in words]
