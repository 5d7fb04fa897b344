"""The command `undistort`: tables that take the distortion out of events and images, with a preview."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bench.commands.options import ExistingFile, ExistingPath, Number, OutputFolder, epilog
from bench.commands.output import JSON, show

if TYPE_CHECKING:
    from bench.results.undistorted import Straightness
    from calib.model.camera import Undistortion


@click.command(
    epilog=epilog(
        "starbench undistort runs/cam7 -o cam7-tables",
        "starbench undistort opencv.yaml -o tables --preview board.raw --board checkerboard:11x7:20mm",
    )
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
@click.option(
    "--board",
    help="The preview shows this board (as in `calibrate --board`): say how straight its lines are before and after.",
)
@JSON
def undistort(file: Path, output: Path, keep: float, preview: Path | None, board: str | None) -> int:
    """Write the tables that take the distortion of RUN's camera out of events and images.

    RUN is a run folder, its results.json, or a calibration of OpenCV, ROS, Kalibr or Metavision. undistort.npz holds
    for each pixel its ray and its place in the rectified image, the pair of maps for OpenCV's remap, and the new camera
    matrix; camera_info.yaml is ROS's, with the new matrix as P.
    """
    from bench.base.errors import UsageError
    from bench.plan.camera_files import read_camera_file
    from bench.records.storage import make_folder, write_atomic
    from bench.results.offline_folder import require_new
    from bench.results.offline_options import parse_board
    from bench.results.undistorted import board_straightness, read_picture_for, undistorted_files
    from calib.model.camera import undistort as tables_of

    if board is not None and preview is None:
        raise UsageError(
            "There is no picture of the board.",
            where="--board",
            remedy="Give a recording or a photograph of it with --preview.",
        )
    require_new(output)
    stated = parse_board(board)
    camera = read_camera_file(file).camera
    picture = read_picture_for(preview, camera) if preview is not None else None
    found = tables_of(camera, keep)
    straight = None
    if picture is not None and stated is not None:
        straight = board_straightness(picture, stated, found, camera, str(preview))
    files = undistorted_files(camera, found, picture)
    make_folder(output)
    for name, data in files.items():
        write_atomic(output / name, data)

    def as_json() -> dict[str, Any]:
        return {
            "folder": str(output),
            "files": list(files),
            "camera_matrix": found.camera.matrix.tolist(),
            "without_ray": found.without_ray,
            "straightness": asdict(straight) if straight is not None else None,
        }

    show(as_json, _lines(output, list(files), found, straight))
    return 0


def _lines(
    output: Path, files: list[str], found: Undistortion, straight: Straightness | None
) -> Iterator[str]:
    new = found.camera
    yield f"Written to {output}: {', '.join(files)}."
    yield f"New camera matrix: fx {new.fx:.2f}, fy {new.fy:.2f}, cx {new.cx:.2f}, cy {new.cy:.2f} px."
    if found.without_ray:
        yield (
            f"{100 * found.without_ray:.2g} % of the pixels have no ray, because the distortion folds back there: their"
            " entries are NaN."
        )
    if straight is not None:
        yield (
            f"The lines of the board: {straight.before_px:.3f} px RMS from straight before, {straight.after_px:.3f} px"
            f" after ({straight.points} points)."
        )
