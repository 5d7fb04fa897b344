"""Calibration without devices: from run folders, RAW captures, photographs and point files. Writes no files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from bench.base.encoding import counted
from bench.base.errors import BenchError, UsageError
from bench.measure.kept_views import KeptViews
from bench.measure.views_file import StoredView
from bench.plan.job import Job
from bench.plan.passports import PassportInUse
from bench.record.conformity import conformity
from bench.record.journal import CAPTURES
from bench.record.results import Conformity, ReadingsUse
from bench.record.run_folder import CHECKED_COPY, RESULTS
from bench.solve.loose_recordings import RECORDINGS, camera_serial, first_names, used_recordings
from bench.solve.offline_options import OfflineOptions
from bench.solve.solution import calibrated
from bench.solve.solve_options import readings_result
from bench.solve.view_sources import (
    ViewSource,
    jobs_of,
    left_beside,
    view_sources,
)
from bench.stations.station_budget import CollimatorConfig
from calib.boards.board import Board
from calib.calibration import CalibrationOptions
from calib.engine import Calibration
from calib.errors import CalibrationError, DegenerateViews
from calib.model.homography import rough_homography
from calib.target import StarTarget
from calib.view import View
from sequences.script import SolveStep

Reached = Callable[[int, int], None]
"""Is told how many views or recordings of all have been read."""
_MOST_NAMES = 5
"""Views of a folder that a message names: a line or two."""
_CLEARLY_MORE = 4
"""So many times as many images as of all other sizes have the size of the camera; nearer numbers decide nothing."""


@dataclass(frozen=True)
class OfflineResult:
    """Result of an offline calibration."""

    calibration: Calibration
    skipped: Sequence[str]  # For each file that was left out, a sentence with the reason
    views: Sequence[View]
    options: CalibrationOptions = field(default_factory=CalibrationOptions)
    sources: Sequence[ViewSource] = ()  # The files of the views, in their order
    passport: PassportInUse | None = None  # The collimator's passport that was used, if any
    # The printed target that all views show: that of the run's station, or of the options; None if they
    # differ.
    target: StarTarget | None = field(default_factory=StarTarget)
    paths: Sequence[Path] = ()
    choices: OfflineOptions = field(default_factory=OfflineOptions)

    @property
    def stored_views(self) -> list[StoredView]:
        """The views with their residuals, without images."""
        return [
            StoredView(view, px) for view, px in zip(self.views, self.calibration.residuals_px, strict=True)
        ]

    @property
    def job(self) -> Job | None:
        """The run of which all views are; None if they are not of one run."""
        jobs = jobs_of(self.sources)
        return jobs[0] if len(jobs) == 1 else None

    @property
    def conformity(self) -> Conformity | None:
        """PASS or FAIL by the limits of the run's station and sequence; None if there are none."""
        if self.job is None:
            return None
        return conformity(self.calibration, self.job.limits, [])

    @property
    def readings(self) -> ReadingsUse | None:
        """Whether the gimbal's readings entered, as results.json states it; None if the views are not of one run."""
        job = self.job
        if job is None:
            return None
        stated = job.station.gimbal is not None
        witness = stated and self.options.gimbal is None
        return readings_result(self.calibration, self.options, witness=witness, stated=stated)

    @property
    def collimator(self) -> CollimatorConfig:
        """What the station states about the collimator, if all views are of runs on one station; else nothing."""
        stated = [
            source.job.station.collimator if source.job else CollimatorConfig() for source in self.sources
        ]
        alike = bool(stated) and all(section == stated[0] for section in stated)
        return stated[0] if alike else CollimatorConfig()

    @property
    def board(self) -> Board | None:
        """The board at finite distance that all views show; None if they show the star target, or not the same."""
        return self.choices.board

    def to_dict(self) -> dict[str, Any]:
        """Return the calibration's content, and ``passport gimbal_readings skipped``, for ``--json``."""
        return {
            **self.calibration.to_dict(),
            "passport": self.passport.to_dict() if self.passport else None,
            "gimbal_readings": self.readings,
            "skipped": list(self.skipped),
            **({"conformity": judged} if (judged := self.conformity) else {}),
        }


def nothing_shown(_done: int, _total: int) -> None:
    """Show no progress."""


def calibrate_paths(
    paths: Sequence[Path],
    choices: OfflineOptions,
    kept: KeptViews | None = None,
    progress: Reached = nothing_shown,
) -> OfflineResult:
    """Make views from files and folders, and calibrate; a file without the target is left out, with the reason.

    ``kept`` are views of earlier calculations, never used to check evidence; None finds the stars in every recording.
    """
    sources = [source for path in paths for source in view_sources(path, choices)]
    if kept is not None:
        sources = [with_kept_views(source, kept) for source in sources]
    result = calibrate_sources(sources, choices, progress)
    left = [sentence for path in paths for sentence in left_beside(path)]
    skipped = [*station_left_out(result.sources, choices), *result.skipped, *left]
    return replace(result, paths=tuple(paths), skipped=skipped)


def _is_one_run(sources: Sequence[ViewSource]) -> bool:
    jobs = jobs_of(sources)
    return len(jobs) == 1 and jobs[0] is not None


def station_left_out(sources: Sequence[ViewSource], choices: OfflineOptions) -> list[str]:
    """Return a sentence on what the station of the command line states and this calibration does not use."""
    file = choices.station
    station = file.station if file else None
    if file is None or station is None:
        return []
    if _is_one_run(sources):
        return [f"{file.name}: A run is calibrated with the station file in its folder."]
    if choices.board is not None:
        return [f"{file.name}: A board is seen without the collimator."]
    if station.gimbal is None:
        return []
    what = "its section gimbal, since only a run has readings of the stage."
    return [f"{file.name}: {what}"]


def only_view(paths: Sequence[Path], choices: OfflineOptions) -> View | None:
    """Return the view of the paths, if they hold one alone."""
    sources = [source for path in paths for source in view_sources(path, choices)]
    if choices.view_numbers:
        sources = [sources[number - 1] for number in choices.view_numbers]
    return sources[0].read() if len(sources) == 1 else None


def with_kept_views(source: ViewSource, kept: KeptViews) -> ViewSource:
    """Let a source take its view, the same to the last bit, from an earlier calculation if there is one."""
    if source.decided_by is None:
        return source
    return replace(source, read=partial(kept.view, source.path, source.decided_by, source.read))


def calibrate_sources(
    sources: Sequence[ViewSource], choices: OfflineOptions, progress: Reached = nothing_shown
) -> OfflineResult:
    """Calibrate from the files of views, without the paths that were given."""
    missing = [number for number in choices.view_numbers or () if number > len(sources)]
    if missing:
        raise UsageError(
            f"There is no view {missing[0]}; the number of views is {len(sources)}.",
            remedy="The first view has the number 1.",
        )
    chosen = [sources[n - 1] for n in choices.view_numbers] if choices.view_numbers else sources
    views, used, skipped = read_views(chosen, progress)
    require_one_camera(used)
    if _is_one_run(used):
        choices = choices.for_one_run()
    options, passport, cautions = _engine_options(used, choices)
    moving = {source.path for source in used if source.view_name}
    used_parts = used_recordings((source.path for source in used if source.job is None), moving)
    cautions += used_parts
    try:
        calibration = calibrated(views, options, cautions, board=choices.board is not None)
    except DegenerateViews as error:
        left_out = [f"{counted(len(skipped), 'file')} left out: {_first(skipped)}"] if skipped else []
        remedy = " ".join([*left_out, *used_parts, error.remedy])
        raise DegenerateViews(error.what, where=error.where, remedy=remedy) from error
    targets = [source.job.target if source.job else choices.target for source in used]
    target = targets[0] if all(other == targets[0] for other in targets) else None
    return OfflineResult(calibration, skipped, views, options, used, passport, target, choices=choices)


def require_common_views(first: Path, second: Path, choices: OfflineOptions) -> None:
    """Refuse one path for both cameras of a rig, or two that share no pose, before any star is looked for."""
    if first.resolve() == second.resolve():
        raise UsageError(
            "Both cameras have the same views.",
            where=str(first),
            remedy="Give the views of the second camera as the second path.",
        )
    names = [{source.name for source in view_sources(path, choices)} for path in (first, second)]
    if not names[0] & names[1]:
        shown = [", ".join(sorted(some)[:_MOST_NAMES]) for some in names]
        raise DegenerateViews(
            f"The two cameras share no pose: {shown[0]} and {shown[1]}.",
            remedy="Give the two views of one pose the same name.",
        )


def require_other_views(calibration: Path, paths: Sequence[Path]) -> None:
    """Refuse a calibration that lies among the views, or is the results of their run: it was made from them."""
    file, views = calibration.resolve(), [path.resolve() for path in paths]
    own = file.with_name(CAPTURES) if file.name == RESULTS else file
    of_them = any(file.is_relative_to(path) or path.is_relative_to(own) for path in views)
    if of_them and file.name != CHECKED_COPY:
        raise UsageError(
            "This calibration was made from the same views. They would count twice.",
            where=str(calibration),
            remedy="Give a calibration from other views.",
        )


def require_one_camera(sources: Sequence[ViewSource]) -> None:
    """Refuse recordings of different cameras, by the stations of their runs or by their headers."""
    names: dict[str, tuple[str, list[str]]] = {}  # Some programs write serial numbers without their zeros
    for source in sources:
        if source.job is not None:  # its recording may be gone, if it came from a URL
            serial = source.job.station.camera.serial or ""
        else:
            serial = camera_serial(source.path) if source.path.suffix.lower() in RECORDINGS else ""
        if serial:
            names.setdefault(serial.lstrip("0"), (serial, []))[1].append(source.name)
    if len(names) > 1:
        shown = ", ".join(f"{serial} ({first_names(of_camera)})" for serial, of_camera in names.values())
        raise BenchError(
            f"The recordings are of {len(names)} cameras, by their serial numbers: {shown}.",
            remedy="Calibrate each camera by itself: give its recordings alone.",
        )


def _engine_options(
    sources: Sequence[ViewSource], choices: OfflineOptions
) -> tuple[CalibrationOptions, PassportInUse | None, list[str]]:
    """Return the engine's options, the passport in use, and what a reader must know about the passport.

    One run is calibrated as it was; several share a passport at most, since the camera may have been mounted anew.
    """
    jobs = jobs_of(sources)
    job = jobs[0] if len(jobs) == 1 else None
    steps = [step for step in job.steps if isinstance(step, SolveStep)] if job is not None else []
    of_runs = [None if run is None else run.plan.passport.in_use for run in jobs]
    passports = {passport.data: passport for passport in of_runs if passport is not None}
    cautions: list[str] = []
    if job is not None and steps:
        angles = [source.attempt.stored["measured_deg"] for source in sources if source.attempt]
        options = choices.of_run(job, steps[-1], angles)
    else:
        common = next(iter(passports.values())) if len(passports) == 1 and None not in of_runs else None
        options = choices.without_run(common)
        if passports and not (common or choices.passport or choices.without_passport):
            cautions.append(
                "The views do not have one passport of a collimator in common, so none was used. Name one (--passport)."
            )
    known = (choices.passport, *passports.values())
    passport = next((one for one in known if one and one.passport is options.passport), None)
    return options, passport, cautions


def read_views(
    sources: Sequence[ViewSource], progress: Reached = nothing_shown
) -> tuple[list[View], list[ViewSource], list[str]]:
    """Read the views, with one image size and unique names; return also their sources, and why views were left out."""
    views: list[View] = []
    used: list[ViewSource] = []
    skipped: list[str] = []
    for number, source in enumerate(sources, start=1):
        try:
            view = source.read()
            if source.attempt is not None:
                view = replace(view, recorded_s=source.attempt.begun_s)
            rough_homography(view)  # a view without one takes no part
        except CalibrationError as error:
            skipped.append(str(error) if str(source.path) in str(error) else f"{source.path}: {error}")
        else:
            views.append(view)
            used.append(source)
        progress(number, len(sources))
    if not views:
        loose = [source.path for source in sources if source.job is None and source.path.is_file()]
        reasons = [*([_first(skipped)] if skipped else []), *used_recordings(loose, in_pieces=loose)]
        raise BenchError(
            "There is no usable view.",
            remedy=" ".join(reasons) or "Give run folders, captures, images or point files.",
        )
    for at, sentence in reversed(odd_sizes(views, used)):
        del views[at], used[at]
        skipped.append(sentence)
    return _distinct(views_of_one_size(views, [source.sized for source in used])), used, skipped


def _first(skipped: Sequence[str]) -> str:
    """Return the first reasons why files were left out, and the number of the others."""
    more = len(skipped) - _MOST_NAMES
    return " ".join(skipped[:_MOST_NAMES]) + (f" And {counted(more, 'more file')}." if more > 0 else "")


def odd_sizes(views: Sequence[View], sources: Sequence[ViewSource]) -> list[tuple[int, str]]:
    """Return place and reason of the few images that have another size than all others; none if they are not few."""
    sizes = Counter(view.image_size for view, source in zip(views, sources, strict=True) if source.sized)
    (size, count), *others = sizes.most_common() or [((0, 0), 0)]
    if count < _CLEARLY_MORE * sum(fewer for _, fewer in others):
        return []
    usual = f"{count} others have {size[0]} x {size[1]} px"
    advice = "Give original images: not turned, not cropped, not made smaller."
    odd = []
    for at, (view, source) in enumerate(zip(views, sources, strict=True)):
        if source.sized and view.image_size != size:
            width, height = view.image_size
            odd.append((at, f"{source.path}: The image has {width} x {height} px, {usual}. {advice}"))
    return odd


def views_of_one_size(views: Sequence[View], sized: Sequence[bool]) -> list[View]:
    """Give all views one image size, or the largest of the point files; sizes that differ are refused."""
    known = {view.image_size: view.name for view, is_sized in zip(views, sized, strict=True) if is_sized}
    width, height = (max(sides) for sides in zip(*(view.image_size for view in views), strict=True))
    if len(known) > 1 or (known and (width, height) not in known):
        sizes = {view.image_size for view in views}
        named = [
            ([each_view.name for each_view in views if each_view.image_size == size], size)
            for size in sorted(sizes)
        ]
        named.sort(key=lambda group: len(group[0]))
        listed = ", ".join(f"{w} x {h} px ({first_names(names)})" for names, (w, h) in named)
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
