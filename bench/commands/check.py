"""The command `check`: whether a calibration is still right, by new views of the camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.calibrations import collimator_options
from bench.commands.options import ExistingPath, epilog
from bench.commands.output import JSON, show
from bench.report.text import with_uncertainty

if TYPE_CHECKING:
    from bench.results.camera_files import CameraFile
    from calib.calibration import Calibration
    from calib.studies.camera_check import CameraCheck

_SEED = 20_260_101
"""The same files give the same numbers."""
_CAUSES = {
    "scale": "A change of scale explains it: the focus or the temperature of the lens changed",
    "principal point": "A shift of the principal point explains it: the lens or the sensor moved in its mount",
    "lens": "A change of the distortion explains it: the lens, its focus or its aperture changed",
    "": "No single change explains it",
}


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
@collimator_options
@JSON
def check(paths: tuple[Path, ...], file: Path, **options: Any) -> int:
    """Check a calibration against new views of the camera in one or more PATHs.

    A PATH is a run folder, a RAW file, an image of the target, or a file of points, as in `calibrate`. The views are
    calibrated alone, and the two cameras are compared over the sensor. One view is enough if the collimator is known,
    by the run's station or by a passport.
    """
    import numpy as np

    from bench.results.camera_files import read_camera_file
    from bench.results.offline import calibrate_paths
    from bench.results.offline_options import OfflineOptions
    from calib.studies.camera_check import check_camera

    stated = read_camera_file(file)
    result = calibrate_paths(list(paths), OfflineOptions.from_command_line(**options))
    found = result.calibration
    checked = check_camera(
        stated.camera, stated.covariance, found.camera, found.camera_covariance, np.random.default_rng(_SEED)
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


def _lines(checked: CameraCheck, stated: CameraFile, found: Calibration, skipped: list[str]) -> Iterator[str]:
    for reason in skipped:
        yield f"Left out: {reason}"
    worst = checked.worst
    there = f"{worst.name}, at ({worst.at_px[0]:.0f}, {worst.at_px[1]:.0f})"
    if checked.right:
        unseen = max(one.expanded_px for one in checked.regions)
        yield f"RIGHT within U everywhere on the sensor: the largest E_n is {worst.normalised:.2f} ({there})."
        yield f"A change of the image of less than {unseen:.2f} px can stay unseen by these views."
    else:
        yield (
            f"NOT RIGHT: {there}, the image moved by {worst.offset_px:.2f} px; U is {worst.expanded_px:.2f} px"
            f" (E_n {worst.normalised:.2f}). {_CAUSES[checked.cause]}."
        )
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
