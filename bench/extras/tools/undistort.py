"""The command `undistort`: tables for other programs that take the distortion out of events and images."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.calibrations import CAMERA, IMAGE_SIZE, LENS, stated_camera
from bench.commands.options import ExistingFile, ExistingPath, OutputFolder, command
from bench.commands.output import JSON, show, wants_json
from bench.commands.values import Number
from bench.commands.workers import PartsLine
from bench.record.storage import new_output, write_files

if TYPE_CHECKING:
    from bench.camera_files.camera_values import LensFamily
    from calib.model.camera import Undistortion


@command(
    "starbench undistort runs/cam7 -o cam7-tables",
    "starbench undistort opencv.yaml -o tables --preview board.raw",
)
@click.argument("file", metavar="RUN", type=ExistingPath())
@click.option("--output", "-o", required=True, type=OutputFolder(), help="New folder for the tables.")
@click.option(
    "--keep",
    type=Number(least=0, most=1),
    default=0.0,
    show_default=True,
    help="0: no empty pixel in the rectified image; 1: every pixel of the sensor is in it; or between them.",
)
@click.option(
    "--preview",
    type=ExistingFile(),
    help="RAW recording or photograph to show before and after, as preview.png.",
)
@CAMERA
@LENS
@IMAGE_SIZE
@JSON
def undistort(
    file: Path,
    output: Path,
    keep: float,
    preview: Path | None,
    camera: str | None,
    lens: LensFamily | None,
    image_size: str | None,
) -> int:
    """Write the tables that take the distortion of RUN's camera out of events and images.

    RUN is a run folder, its results.json, or a calibration of OpenCV, ROS, Kalibr, mrcal, COLMAP or Metavision.
    undistort.npz holds for each pixel its ray and its place in the rectified image, the pair of maps for OpenCV's
    remap, and the camera matrix before and after; camera_info.yaml is ROS's, with the new matrix as P.
    """
    from bench.base.image_size import parse_image_size
    from bench.extras.tools.undistorted_files import read_picture_for, undistorted_files
    from calib.model.camera import undistort as tables_of

    with new_output(output) as part:
        stated = stated_camera(file, camera, lens, parse_image_size(image_size)).camera
        picture = read_picture_for(preview, stated) if preview is not None else None
        line = PartsLine("blocks of pixels calculated", "the tables are compressed", quiet=wants_json())
        with line.shown() as reached:
            undistortion = tables_of(stated, keep, reached)
            files = undistorted_files(stated, undistortion, picture)
        write_files(part, files)

    def as_json() -> dict[str, Any]:
        return {
            "folder": str(output),
            "files": list(files),
            "camera_matrix": stated.matrix.tolist(),
            "new_camera_matrix": undistortion.camera.matrix.tolist(),
            "without_ray": undistortion.without_ray,
        }

    show(as_json, _lines(output, list(files), undistortion))
    return 0


def _lines(output: Path, files: list[str], undistortion: Undistortion) -> Iterator[str]:
    new = undistortion.camera
    yield f"Written to {output}: {', '.join(files)}."
    yield f"New camera matrix: fx {new.fx:.2f}, fy {new.fy:.2f}, cx {new.cx:.2f}, cy {new.cy:.2f} px."
    if undistortion.without_ray:
        yield (
            f"{100 * undistortion.without_ray:.2g} % of the pixels have no ray, because the distortion folds back"
            " there: their entries are NaN."
        )
