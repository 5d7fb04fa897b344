"""Calibration without devices: from run folders, RAW captures, photographs of the target and point files.

`view_sources` recognises the files and makes the views; this module passes them to the engine. Writes no files.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from bench.base.errors import BenchError, UsageError
from bench.results.comparison import planar_calibration
from bench.results.offline_options import OfflineOptions
from bench.results.view_sources import ViewSource, view_sources
from calib.engine import Calibration, calibrate
from calib.errors import CalibrationError
from calib.studies.reference_methods import MethodFailure, MethodResult, reference_results, starbench_result
from calib.view import View


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
        The calibration. A file in which the target is not found is left out, with the reason.

    Raises
    ------
    UsageError
        When a requested view does not exist, or a path cannot be used.
    BenchError
        When a file cannot be read, the image sizes differ, or no view is left.
    calib.errors.CalibrationError
        When the views do not determine the camera.
    """
    sources = [source for path in paths for source in view_sources(path, choices)]
    missing = [number for number in choices.view_numbers or () if number > len(sources)]
    if missing:
        raise UsageError(
            f"There is no view {missing[0]}; the number of views is {len(sources)}.",
            remedy="The first view has the number 1.",
        )
    chosen = [sources[n - 1] for n in choices.view_numbers] if choices.view_numbers else sources
    views, skipped = _read_views(chosen)
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


def _read_views(sources: Sequence[ViewSource]) -> tuple[list[View], list[str]]:
    """Read the views, with one image size and unique names; return also why views were left out.

    Raises
    ------
    BenchError
        When a file cannot be read, the image sizes differ, or no view is left.
    """
    views, sized, skipped = [], [], []
    for source in sources:
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
    return _distinct(_one_size(views, sized)), skipped


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
