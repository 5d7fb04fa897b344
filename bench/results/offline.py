"""Calibration without devices: from run folders, RAW captures, photographs of the target and point files.

Recognises each path, makes its views in order, and passes them to the engine. Reads files only, writes none.
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
    """Options of an offline calibration.

    Attributes
    ----------
    options
        Options of the engine.
    image_size
        Width and height for point files, px.
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
        """Parse the options of the command line.

        Parameters
        ----------
        model, distortion, loss
            Options of the engine, see `CalibrationOptions`.
        image_size
            Width and height for point files, as ``1280x720``.
        views
            Numbers of the views to use, as ``1,5,9``.
        image
            Kind of event image.
        origin
            ``corner`` or ``centre``.
        station
            Path or name of the station whose target was recorded; None for the standard target.
        passport
            Passport file of the collimator.
        guard_band
            Fraction of the visible disc's radius beyond which stars are left out, see `CalibrationOptions`.

        Returns
        -------
        OfflineOptions
            The parsed options.

        Raises
        ------
        UsageError
            When an option is invalid; the message names it.
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
                f"Unknown event image {image!r}.", remedy=f"Known are {', '.join(get_args(ImageKind))}."
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
    """Result of an offline calibration.

    Attributes
    ----------
    calibration
        The calibration.
    planar
        The planar calibration of the same points; None if there is none.
    skipped
        For each file that was left out, a sentence with the reason.
    views
        The views of the calibration.
    """

    calibration: Calibration
    planar: Calibration | None
    skipped: Sequence[str]
    views: Sequence[View]

    def to_dict(self) -> dict[str, Any]:
        """Return the content as ``--json`` prints it.

        Returns
        -------
        dict
            The calibration's content, and ``planar`` and ``skipped``.
        """
        return {
            **self.calibration.to_dict(),
            "planar": self.planar.to_dict() if self.planar else None,
            "skipped": list(self.skipped),
        }


def calibrate_paths(paths: Sequence[Path], choices: OfflineOptions) -> OfflineResult:
    """Make views from files and folders, and calibrate.

    Parameters
    ----------
    paths
        Run folders, folders of files, or files.
    choices
        Options of the calibration.

    Returns
    -------
    OfflineResult
        The calibration; a file from which no view can be made is left out, with the reason.

    Raises
    ------
    UsageError
        When a requested view does not exist, or a path cannot be used.
    BenchError
        When a file cannot be read, the image sizes differ, or no view is left.
    calib.errors.CalibrationError
        When the views do not determine the camera.
    """
    sources = [source for path in paths for source in _sources(path, choices)]
    missing = [number for number in choices.view_numbers or () if number > len(sources)]
    if missing:
        raise UsageError(
            f"There is no view {missing[0]}; the number of views is {len(sources)}.",
            remedy="The first view has the number 1.",
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
            "There is no usable view.",
            remedy=" ".join(skipped) or "Give run folders, captures, images or point files.",
        )
    views = _distinct(_one_size(views, sized))
    calibration = calibrate(views, choices.options)
    planar = planar_calibration(views, choices.options) if calibration.model != "planar" else None
    return OfflineResult(calibration, planar, skipped, views)


def compare_methods(result: OfflineResult, choices: OfflineOptions) -> list[MethodResult | MethodFailure]:
    """Compare a calibration with the published recipe and with OpenCV's planar method, on the same points.

    Parameters
    ----------
    result
        The calibration and its views.
    choices
        Options of the calibration.

    Returns
    -------
    list
        The result of each method; if a method has no result, its entry says why.
    """
    return [starbench_result(result.calibration), *reference_results(result.views, choices.options)]


@dataclass(frozen=True)
class _Source:
    """A file from which a view can be made; ``sized`` if the size of its image is known."""

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
                "The folder contains no run, capture, image or point file.",
                where=str(path),
                remedy=f"Known file extensions are {', '.join(sorted(_KNOWN))}.",
            )
        for file in files:
            yield _file_source(file, choices)
    else:
        yield _file_source(path, choices)


def _run_sources(folder: Path, choices: OfflineOptions) -> Iterator[_Source]:
    """List the accepted recordings of a run, to be measured with the settings of its own sequence and station."""
    entries, _ = read_journal(folder / JOURNAL)
    history = replay(entries)
    job = Job.from_files(str(folder / SEQUENCE_COPY), str(folder / STATION_COPY), seed=0, operator=None)
    accepted = history.accepted()
    if not accepted:
        raise BenchError(
            "No recording of this run was accepted.",
            where=str(folder),
            remedy="Give the files of its captures instead.",
        )
    for index, attempt in sorted(accepted.items()):
        step = job.record_step(index)
        step = step if choices.image == "auto" else replace(step, image=cast("ImageKind", choices.image))
        path = folder / str(attempt.stored["capture"])
        yield _Source(path, partial(_view_of_run, job, path, step, as_before(attempt)))


def _refuse_truncated(path: Path) -> None:
    """Refuse an incomplete recording: its last word is cut, or its size differs from that in the run's journal.

    Raises
    ------
    RecordingCorrupt
        With the byte at which it ends.
    """
    size = path.stat().st_size
    run = path.resolve().parent.parent
    name = path.resolve().relative_to(run).as_posix()
    stored = stored_captures(read_journal(run / JOURNAL)[0]) if (run / JOURNAL).is_file() else {}
    half_a_word = path.suffix.lower() in RECORDINGS and RawFile.open(path).truncated
    if half_a_word or (name in stored and stored[name].size != size):
        whole = f": {stored[name].size} bytes were recorded" if name in stored else ": it ends within a word"
        raise RecordingCorrupt(
            f"The recording is incomplete{whole}.",
            offset=size,
            where=str(path),
            remedy="Copy it again from its origin, or leave it out.",
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
        f"Unknown file extension {ending!r}." if ending else "The file has no extension.",
        where=str(path),
        remedy=f"Known file extensions are {', '.join(sorted(_KNOWN))}.",
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
    """Refuse a JPEG without its end marker, because OpenCV fills the missing part with grey."""
    if path.suffix.lower() not in _JPEG:
        return
    try:
        data = path.read_bytes()
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


def _one_size(views: Sequence[View], sized: Sequence[bool]) -> list[View]:
    """Give all views one image size; if no view has a known size, the largest of the point files.

    Raises
    ------
    BenchError
        When sizes differ, for example of portrait and landscape images: these are not the pixels of one camera.
    """
    known = {view.image_size: view.name for view, is_sized in zip(views, sized, strict=True) if is_sized}
    width, height = (max(sides) for sides in zip(*(view.image_size for view in views), strict=True))
    if len(known) > 1 or (known and (width, height) not in known):
        sizes = {view.image_size: view.name for view in views}
        listed = ", ".join(f"{w} x {h} px ({name})" for (w, h), name in sorted(sizes.items()))
        raise BenchError(
            f"The views have different image sizes: {listed}.",
            remedy="Calibrate each camera separately, with original images: not rotated, not cropped.",
        )
    return [replace(view, image_size=(width, height)) for view in views]


def _distinct(views: Sequence[View]) -> list[View]:
    """Add its number to the name of each view whose name is not unique."""
    names = [view.name for view in views]
    return [
        replace(view, name=f"{view.name} ({number})") if names.count(view.name) > 1 else view
        for number, view in enumerate(views, 1)
    ]


def _natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Return a sort key that puts image10 after image9."""
    words = re.split(r"(\d+)", path.name)
    return [(0, int(word), "") if word.isdigit() else (1, 0, word) for word in words]


def _parse_image_size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    found = re.fullmatch(r"([1-9]\d{0,5})[xX]([1-9]\d{0,5})", text.strip())
    if found is None:
        raise UsageError(
            f"{text!r} is not an image size.",
            where="--image-size",
            remedy="Write it as WIDTHxHEIGHT: 1280x720.",
        )
    return int(found[1]), int(found[2])


def _parse_view_numbers(text: str | None) -> tuple[int, ...] | None:
    if text is None:
        return None
    words = [word.strip() for word in text.split(",")]
    if not all(re.fullmatch(r"[1-9]\d{0,5}", word) for word in words) or len(set(words)) != len(words):
        raise UsageError(
            f"{text!r} is not a list of view numbers.",
            where="--views",
            remedy="Write different numbers from 1, for example 1,5,9.",
        )
    return tuple(int(word) for word in words)
