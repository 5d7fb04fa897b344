"""The command `check`: whether new views agree with a calibration."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.calibrations import BOARD, CAMERA, LENS, collimator_options, stated_camera
from bench.commands.options import ExistingPath, epilog
from bench.commands.output import JSON, left_out_lines, show, wants_json
from bench.commands.workers import views_line
from bench.wording.numbers import plus_minus

if TYPE_CHECKING:
    from bench.camera_files.camera_values import LensFamily
    from bench.camera_files.reader import CameraFile
    from calib.calibration import Calibration
    from calib.model.camera import CameraModel
    from calib.model.result_parts import CameraCheck
    from calib.view import View


@click.command(
    epilog=epilog(
        "starbench check runs/today --calibration runs/last-year",
        "starbench check points/*.csv --image-size 1280x720 --calibration camera_info.yaml",
    )
    + "\n\nExit status: 0 the views agree with the calibration within U, 1 they do not."
)
@click.argument("paths", nargs=-1, required=True, metavar="PATH...", type=ExistingPath())
@click.option(
    "--calibration",
    "file",
    required=True,
    type=ExistingPath(),
    help="The calibration to check: a run folder or its results.json, or a file of OpenCV, ROS, Kalibr, mrcal, COLMAP"
    " or Metavision.",
)
@CAMERA
@LENS
@BOARD
@collimator_options
@JSON
def check(
    paths: tuple[Path, ...], file: Path, camera: str | None, lens: LensFamily | None, **options: Any
) -> int:
    """Check a calibration against new views of the camera in one or more PATHs.

    A PATH is a run folder, a RAW file, an image of the target, or a file of points, as in `calibrate`. The views are
    calibrated alone, and the two cameras are compared over the sensor. One view is enough if the collimator is known,
    by the run's station or by a passport. One view without it is judged as far as no other pose explains it.
    """
    from bench.solve.offline import calibrate_paths, only_view, require_other_views
    from bench.solve.offline_options import OfflineOptions
    from bench.solve.solution import compared_with
    from calib.errors import DegenerateViews

    choices = OfflineOptions.from_command_line(**options)
    stated = stated_camera(file, camera, lens, choices.image_size)
    require_other_views(stated.path, paths)
    if choices.board is not None and choices.distortion is None:
        choices = replace(choices, distortion=_lens_of(stated.camera))
    try:
        with views_line(quiet=wants_json()) as progress:
            result = calibrate_paths(list(paths), choices, progress=progress)
    except DegenerateViews:
        view = only_view(list(paths), choices)
        if view is None:
            raise
        return _check_by_one(stated, view, board=choices.board is not None)
    calibration = result.calibration
    checked = compared_with(stated, calibration)

    def as_json() -> dict[str, Any]:
        return {
            **checked.to_dict(),
            "stated": {"kind": stated.kind, "uncertainty": stated.covariance is not None},
            "camera": calibration.camera.to_dict(),
            "skipped": list(result.skipped),
        }

    show(as_json, _lines(checked, stated, calibration, list(result.skipped)))
    return 0 if checked.right else 1


def _lens_of(camera: CameraModel) -> str:
    """Return the coefficients that a camera of the stated lens is estimated with, in one word."""
    from calib.model.camera import SKEW
    from calib.model.lens import BROWN, FISHEYE

    names = {"k1", "k2"} | {name for name, value in camera.distortion.items() if value}
    if set(camera.distortion) & set(FISHEYE):
        return "fisheye"
    return "".join(name for name in (*BROWN, SKEW) if name in names)


def _check_by_one(stated: CameraFile, view: View, *, board: bool) -> int:
    """Tell what one view can tell that does not determine the camera."""
    from bench.wording.camera_check import one_view_sentences
    from calib.studies.camera_check import check_one_view

    checked = check_one_view(stated.camera, stated.covariance, view)
    about = {"kind": stated.kind, "uncertainty": stated.covariance is not None}
    show(lambda: {**checked.to_dict(), "stated": about}, one_view_sentences(checked, board=board))
    return 0 if checked.right else 1


def _lines(
    checked: CameraCheck, stated: CameraFile, calibration: Calibration, skipped: list[str]
) -> Iterator[str]:
    yield from left_out_lines(skipped)
    from bench.wording.camera_check import check_sentences

    yield from check_sentences(checked)
    yield f"Change of the image and its U, px (k = {checked.coverage_factor:.2f}, for all places at once):"
    for start in range(0, len(checked.regions), 3):
        row = checked.regions[start : start + 3]
        yield "  " + "   ".join(
            f"{region.name:<13} {region.offset_px:6.2f} ± {region.expanded_px:.2f}" for region in row
        )
    for name in ("fx", "fy", "cx", "cy"):
        now = plus_minus(calibration.values[name], calibration.U[name], "px")
        yield f"  {name} was {getattr(stated.camera, name):.2f}, is {now} (k = {calibration.k[name]:.2f})"
    if stated.covariance is None:
        yield f"U is that of the new views alone: {stated.kind} states no uncertainty."
    yield from (f"Note: {note}" for note in calibration.notes)
