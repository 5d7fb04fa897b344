"""The command `check`: whether a calibration is still right, by new views of the camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from bench.commands.calibrations import BOARD, collimator_options
from bench.commands.options import ExistingPath, epilog
from bench.commands.output import JSON, show
from bench.report.text import with_uncertainty

if TYPE_CHECKING:
    from bench.plan.camera_files import CameraFile
    from bench.records.results import CheckData
    from calib.calibration import Calibration
    from calib.studies.camera_check import CameraCheck
    from calib.view import View


@click.command(
    epilog=epilog(
        "starbench check runs/today --calibration runs/last-year",
        "starbench check points/*.csv --image-size 1280x720 --calibration camera_info.yaml",
    )
    + "\n\nExit status: 0 right within U, 1 not right."
)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=ExistingPath())
@click.option(
    "--calibration",
    "file",
    required=True,
    type=ExistingPath(),
    help="The calibration to check: a run folder or its results.json, OpenCV's YAML, ROS's camera_info, Kalibr's"
    " camchain, Metavision's intrinsics.json or camera-geometry.json.",
)
@BOARD
@collimator_options
@JSON
def check(paths: tuple[Path, ...], file: Path, **options: Any) -> int:
    """Check a calibration against new views of the camera in one or more PATHs.

    A PATH is a run folder, a RAW file, an image of the target, or a file of points, as in `calibrate`. The views are
    calibrated alone, and the two cameras are compared over the sensor. One view is enough if the collimator is known,
    by the run's station or by a passport. One view without it is judged as far as no other pose explains it.
    """
    import numpy as np

    from bench.plan.camera_files import read_camera_file
    from bench.results.offline import calibrate_paths, only_view
    from bench.results.offline_options import OfflineOptions
    from bench.results.solution import CHECK_SEED
    from calib.errors import DegenerateViews
    from calib.studies.camera_check import check_camera

    stated, choices = read_camera_file(file), OfflineOptions.from_command_line(**options)
    try:
        result = calibrate_paths(list(paths), choices)
    except DegenerateViews:
        view = only_view(list(paths), choices)
        if view is None:
            raise
        return _check_by_one(stated, view, board=choices.board is not None)
    found = result.calibration
    checked = check_camera(
        stated.camera,
        stated.covariance,
        found.camera,
        found.camera_covariance,
        np.random.default_rng(CHECK_SEED),
    )

    def as_json() -> dict[str, Any]:
        return {
            **checked.to_dict(),
            "stated": {"kind": stated.kind, "uncertainty": stated.covariance is not None},
            "camera": found.camera.to_dict(),
            "skipped": list(result.skipped),
        }

    show(as_json, _lines(checked, stated, found, list(result.skipped)))
    return 0 if checked.right else 1


def _check_by_one(stated: CameraFile, view: View, *, board: bool) -> int:
    """Tell what one view can tell that does not determine the camera."""
    from bench.report.text import one_view_sentences
    from calib.studies.one_view_check import check_one_view

    checked = check_one_view(stated.camera, stated.covariance, view)
    about = {"kind": stated.kind, "uncertainty": stated.covariance is not None}
    show(lambda: {**checked.to_dict(), "stated": about}, one_view_sentences(checked, board=board))
    return 0 if checked.right else 1


def _lines(checked: CameraCheck, stated: CameraFile, found: Calibration, skipped: list[str]) -> Iterator[str]:
    for reason in skipped:
        yield f"Left out: {reason}"
    from bench.report.text import check_sentences

    yield from check_sentences(cast("CheckData", checked.to_dict()))
    yield f"Change of the image and its U, px (k = {checked.coverage_factor:.2f}, for all places at once):"
    for start in range(0, len(checked.regions), 3):
        row = checked.regions[start : start + 3]
        yield "  " + "   ".join(f"{one.name:<13} {one.offset_px:6.2f} ± {one.expanded_px:.2f}" for one in row)
    sigma = found.sigma
    for name in ("fx", "fy", "cx", "cy"):
        k = found.coverage_factors.get(name, found.coverage_factor)
        value, expanded = with_uncertainty(getattr(found.camera, name), k * sigma[name])
        yield f"  {name} was {getattr(stated.camera, name):.2f}, is {value} ± {expanded} px (k = {k:.2f})"
    if stated.covariance is None:
        yield f"U is that of the new views alone: {stated.kind} states no uncertainty."
    yield from (f"Note: {note}" for note in found.notes)
