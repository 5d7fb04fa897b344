"""Calibrates again without devices: from run folders, RAW captures, photographs of the target, point files.

Finds out what each path is, makes views of them in order, and hands them to the engine. Reads only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Self, cast, get_args

from bench.base.errors import BenchError, StorageError, UsageError
from bench.plan.job import Job
from bench.records.captures import stored_captures
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.records.run_folder import JOURNAL, SEQUENCE_COPY, STATION_COPY
from bench.results.comparison import planar_calibration
from bench.results.passports import read_passport
from bench.results.point_files import Origin, read_point_file
from bench.stations.station import load_station
from bench.views.expected_grid import as_before
from bench.views.measure import Expect, Measurement, measure
from calib.engine import Calibration, CalibrationOptions, calibrate
from calib.errors import CalibrationError, TooFewStars
from calib.stars.detect import detect_view
from calib.stars.vignetting import downweight_vignetted
from calib.studies.reference_methods import MethodFailure, MethodResult, reference_results, starbench_result
from calib.target import StarTarget
from calib.view import View
from drivers.camera.frames import mean_frame
from drivers.camera.raw_file import RawFile
from drivers.errors import RecordingCorrupt, RecordingFileError
from sequences.schema import ImageKind
from sequences.script import RecordStep

RECORDINGS = {".raw"}
PHOTOGRAPHS = {".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm"}
POINTS = {".txt", ".csv"}
_KNOWN = RECORDINGS | PHOTOGRAPHS | POINTS
_JPEG = {".jpg", ".jpeg"}
_JPEG_BEGINS, _JPEG_SCAN, _JPEG_ENDS = b"\xff\xd8", b"\xff\xda", b"\xff\xd9"


@dataclass(frozen=True)
class OfflineOptions:
    """What the operator chose.

    Attributes
    ----------
    options
        The engine's.
    image_size
        For point files.
    view_numbers
        Numbers of the views to use, from 1; None for all.
    image
        Kind of event image for RAW captures.
    origin
        Pixel origin of point files.
    target
        The printed target.
    """

    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    image_size: tuple[int, int] | None = None
    view_numbers: tuple[int, ...] | None = None
    image: str = "auto"
    origin: Origin = "corner"
    target: StarTarget = field(default_factory=StarTarget)

    @classmethod
    def from_command_line(
        cls,
        *,
        model: str,
        distortion: str,
        loss: str,
        image_size: str | None,
        views: str | None,
        image: str,
        origin: str,
        station: str | None,
        passport: Path | None = None,
        guard_band: float = 1.0,
    ) -> Self:
        """Read the command line's words.

        Raises
        ------
        UsageError
            Naming the word that makes no sense.
        """
        try:
            options = CalibrationOptions(
                model,  # type: ignore[arg-type]
                distortion,
                loss,  # type: ignore[arg-type]
                passport=read_passport(passport) if passport else None,
                guard_band=guard_band,
            )
        except CalibrationError as error:
            raise UsageError(error.what, remedy=error.remedy) from error
        if image not in get_args(ImageKind):
            raise UsageError(
                f"No event image is called {image!r}.", remedy=f"Known are {', '.join(get_args(ImageKind))}."
            )
        return cls(
            options,
            _parse_image_size(image_size),
            _parse_view_numbers(views),
            image,
            "centre" if origin == "centre" else "corner",
            load_station(station).value.target.pattern() if station else StarTarget(),
        )


@dataclass(frozen=True)
class OfflineResult:
    """A calibration, the planar one on the same points, what was left out and why, and the views themselves."""

    calibration: Calibration
    planar: Calibration | None
    skipped: Sequence[str]
    views: Sequence[View]

    def to_dict(self) -> dict[str, Any]:
        """Give it as ``--json`` prints it."""
        return {
            **self.calibration.to_dict(),
            "planar": self.planar.to_dict() if self.planar else None,
            "skipped": list(self.skipped),
        }


def calibrate_paths(paths: Sequence[Path], choices: OfflineOptions) -> OfflineResult:
    """Make views of paths and calibrate from them.

    Raises
    ------
    UsageError
        When there is no such view, or a path is nothing that can be used.
    BenchError
        When a file named outright cannot be used, images differ in size, or no view is left.
    calib.errors.CalibrationError
        When the views do not constrain the camera.
    """
    sources = [source for path in paths for source in _sources(path, choices)]
    missing = [number for number in choices.view_numbers or () if number > len(sources)]
    if missing:
        raise UsageError(
            f"There is no view {missing[0]}: there are {len(sources)}.", remedy="Views count from 1."
        )
    chosen = [sources[n - 1] for n in choices.view_numbers] if choices.view_numbers else sources
    views, sized, skipped = [], [], []
    for source in chosen:
        try:
            views.append(source.read())
            sized.append(source.sized)
        except CalibrationError as error:
            skipped.append(str(error) if str(source.path) in str(error) else f"{source.path}: {error}")
    if not views:
        raise BenchError(
            "No usable view.", remedy=" ".join(skipped) or "Name runs, captures, images or point files."
        )
    views = _distinct(_one_size(views, sized))
    calibration = calibrate(views, choices.options)
    planar = planar_calibration(views, choices.options) if calibration.model != "planar" else None
    return OfflineResult(calibration, planar, skipped, views)


def compare_methods(result: OfflineResult, choices: OfflineOptions) -> list[MethodResult | MethodFailure]:
    """Hold a calibration against the published recipe and OpenCV's planar method, on the same points.

    A method without an answer says why in its row; that is no fault of ours.
    """
    return [starbench_result(result.calibration), *reference_results(result.views, choices.options)]


@dataclass(frozen=True)
class _Source:
    """A file that a view can be made of; ``sized`` where it is known how large its image is."""

    path: Path
    read: Callable[[], View]
    sized: bool = True


def _sources(path: Path, choices: OfflineOptions) -> Iterator[_Source]:
    if not path.exists():
        raise UsageError("There is no such file or folder.", where=str(path), remedy="Check the path.")
    if path.is_dir() and (path / JOURNAL).is_file():
        yield from _run_sources(path, choices)
    elif path.is_dir():
        files = sorted((p for p in path.iterdir() if p.suffix.lower() in _KNOWN), key=_natural_order)
        if not files:
            raise UsageError(
                "The folder holds no run, capture, image or point file.",
                where=str(path),
                remedy=f"Known endings are {', '.join(sorted(_KNOWN))}.",
            )
        for file in files:
            yield _file_source(file, choices)
    else:
        yield _file_source(path, choices)


def _run_sources(folder: Path, choices: OfflineOptions) -> Iterator[_Source]:
    """Take the accepted recordings of a run, looked at as its own sequence and station say."""
    entries, _ = read_journal(folder / JOURNAL)
    history = replay(entries)
    job = Job.from_files(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY), seed=0, operator=None)
    accepted = history.accepted()
    if not accepted:
        raise BenchError(
            "No recording of this run was accepted.", where=str(folder), remedy="Name its captures instead."
        )
    for index, attempt in sorted(accepted.items()):
        step = job.record_step(index)
        step = step if choices.image == "auto" else replace(step, image=cast("ImageKind", choices.image))
        path = folder / str(attempt.stored["capture"])
        yield _Source(path, partial(_view_of_run, job, path, step, as_before(attempt)))


def _refuse_truncated(path: Path) -> None:
    """Refuse a recording that is not whole: by its last word and, inside a run folder, by what its journal says.

    Raises
    ------
    RecordingCorrupt
        Naming the byte at which it ends.
    """
    size = path.stat().st_size
    run = path.resolve().parent.parent
    name = path.resolve().relative_to(run).as_posix()
    told = stored_captures(read_journal(run / JOURNAL)[0]) if (run / JOURNAL).is_file() else {}
    half_a_word = path.suffix.lower() in RECORDINGS and RawFile.open(path).truncated
    if half_a_word or (name in told and told[name].size != size):
        whole = f"; {told[name].size} were recorded" if name in told else ", in the middle of a word"
        raise RecordingCorrupt(
            f"The recording is cut off{whole}.",
            offset=size,
            where=str(path),
            remedy="Copy it again from where it was recorded, or leave it out.",
        )


def _view_of_run(job: Job, path: Path, step: RecordStep, expect: Expect | None) -> View:
    _refuse_truncated(path)
    return _view(job.camera_kind.measure(path, step, job.frequency_hz(step), job.target, expect), path)


def _file_source(path: Path, choices: OfflineOptions) -> _Source:
    ending = path.suffix.lower()
    if ending in RECORDINGS:
        return _Source(path, partial(_view_of_recording, path, choices))
    if ending in PHOTOGRAPHS:
        return _Source(path, partial(_view_of_photograph, path, choices))
    if ending in POINTS:
        return _Source(
            path,
            partial(read_point_file, path, image_size=choices.image_size, origin=choices.origin),
            sized=choices.image_size is not None,
        )
    raise UsageError(
        f"Nothing is known of files that end in {ending or 'nothing'}.",
        where=str(path),
        remedy=f"Known endings are {', '.join(sorted(_KNOWN))}.",
    )


def _view_of_recording(path: Path, choices: OfflineOptions) -> View:
    _refuse_truncated(path)
    found = measure(
        path, name=path.stem, target=choices.target, image=choices.image, periods=None, expected_hz=None
    )
    return _view(found, path)


def _view(found: Measurement, path: Path) -> View:
    if found.view is None:
        raise TooFewStars(found.fault, where=str(path))
    return found.view


def _view_of_photograph(path: Path, choices: OfflineOptions) -> View:
    _refuse_truncated_jpeg(path)
    try:
        picture = mean_frame(path)
    except RecordingFileError as error:
        raise BenchError(error.what, where=str(path), remedy="Give PNG, TIFF, JPEG or BMP.") from error
    return downweight_vignetted(detect_view(picture, choices.target, name=path.stem), choices.target)


def _refuse_truncated_jpeg(path: Path) -> None:
    """Refuse a JPEG without its end: it is read as grey from there on. Raises RecordingCorrupt, StorageError."""
    if path.suffix.lower() not in _JPEG:
        return
    try:
        data = path.read_bytes()
    except OSError as error:
        raise StorageError(f"It cannot be read: {error.strerror}.", where=str(path)) from error
    # Neither marker can stand within coded data; a preview's stand before those of the picture.
    if data.startswith(_JPEG_BEGINS) and data.rfind(_JPEG_ENDS) < data.rfind(_JPEG_SCAN):
        raise RecordingCorrupt(
            "The picture is cut off.",
            offset=len(data),
            where=str(path),
            remedy="Copy it again, or leave it out.",
        )


def _one_size(views: Sequence[View], sized: Sequence[bool]) -> list[View]:
    """See that images are of one size, and give it to all; where none is known, the largest of the point files.

    Raises
    ------
    BenchError
        When sizes differ, as pictures on end do from those lying: these are not one camera's pixels.
    """
    known = {view.image_size: view.name for view, told in zip(views, sized, strict=True) if told}
    width, height = (max(sides) for sides in zip(*(view.image_size for view in views), strict=True))
    if len(known) > 1 or (known and (width, height) not in known):
        told = {view.image_size: view.name for view in views}
        listed = ", ".join(f"{w} x {h} px ({name})" for (w, h), name in sorted(told.items()))
        raise BenchError(
            f"The views are of different image sizes: {listed}.",
            remedy="Calibrate each camera alone, with pictures as the sensor gives them, none turned or cropped.",
        )
    return [replace(view, image_size=(width, height)) for view in views]


def _distinct(views: Sequence[View]) -> list[View]:
    """Tell views of one name apart by their number."""
    names = [view.name for view in views]
    return [
        replace(view, name=f"{view.name} ({number})") if names.count(view.name) > 1 else view
        for number, view in enumerate(views, 1)
    ]


def _natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Sort key by which image10 follows image9."""
    words = re.split(r"(\d+)", path.name)
    return [(0, int(word), "") if word.isdigit() else (1, 0, word) for word in words]


def _parse_image_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text.strip())
    if found is None:
        raise UsageError(
            f"{text!r} is not an image size.", where="--image-size", remedy="Write it as 1280x720."
        )
    return int(found[1]), int(found[2])


def _parse_view_numbers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"[1-9]\d{0,5}", word) for word in words) or len(set(words)) != len(words):
        raise UsageError(
            f"{text!r} is no list of views.",
            where="--views",
            remedy="Write different numbers from 1, as 1,5,9.",
        )
    return tuple(int(word) for word in words)
