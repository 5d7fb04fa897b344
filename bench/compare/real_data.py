"""Columns on recorded data: calibrations of random subsets of real views, of which no truth is known.

Each repetition draws two disjoint subsets. Their difference shows whether the stated uncertainties hold as far as two
parts of the same data can show it: an error that both share, such as that of the collimator, stays hidden.
"""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from bench.base.errors import BenchError
from bench.compare.spec import ColumnConfig, DataConfig
from bench.records.storage import storage_errors
from calib.calibration import Calibration, CalibrationOptions
from calib.engine import calibrate
from calib.errors import CalibrationError
from calib.model.camera import CameraModel
from calib.studies.reference_methods import MethodResult, opencv_planar, published_recipe, starbench_result
from calib.uncertainty.projection_uncertainty import camera_difference
from calib.view import View

_CSV_COLUMNS = 6
_ACROSS = 17
_K = 2.0
_NAMES = ("fx", "fy", "cx", "cy")


def data_digest(data: DataConfig) -> str:
    """Return a hash of the files of recorded data, so that rows are made again when the data change.

    Returns: Hexadecimal; ``missing`` if there is no such file or folder.
    """
    files = _files(data)
    if not files:
        return "missing"
    content = hashlib.sha256()
    with storage_errors(Path(data.path)):
        for file in files:
            content.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return content.hexdigest()


def read_data(data: DataConfig) -> tuple[View, ...]:
    """Read all views.

    data: Where they are.
    Returns: In order of their names or numbers.
    Raises BenchError: If there is no such data, or a file is not of the form.
    Raises StorageError: If a file cannot be read.
    """
    return _read(data.model_dump_json(), data_digest(data))


def solve_data(column: ColumnConfig, seed: int) -> dict[str, Any]:
    """Calibrate two random disjoint subsets of recorded views.

    column: A column with ``data``.
    Returns: A row: camera, sigmas and residuals of the first subset, and its difference from the second; or
      ``error``.
    """
    row: dict[str, Any] = {"views": 0, "missed": [], "images_cpu_s": 0.0}
    began = time.process_time()
    assert column.data is not None
    try:
        views = read_data(column.data)
        if len(views) < 2 * column.images:
            return row | {"error": f"{len(views)} views are too few for two subsets of {column.images}"}
        order = np.random.default_rng((seed, 41)).permutation(len(views))
        parts = [
            [views[i] for i in sorted(order[start : start + column.images])] for start in (0, column.images)
        ]
        (first, found), (second, _) = (_calibrated(column, part) for part in parts)
    except (BenchError, CalibrationError) as error:
        return row | {"error": str(error)}
    k = found.coverage_factor if found is not None else _K
    left_out = _left_out_px(first.camera, parts[1]) if column.data.board else first.left_out_rms_px
    apart = np.asarray(camera_difference(second.camera, first.camera, _ACROSS).offset_px)
    return row | {
        "views": column.images,
        "camera": first.camera.to_dict(),
        "sigma": dict(first.sigma),
        "k": k,
        "model": found.model if found is not None else None,
        "rms_px": first.rms_px,
        "mean_px": first.mean_px,
        "left_out_px": left_out,
        "errors": {},
        "direction_rms_urad": None,
        "direction_worst_urad": None,
        "centre_urad": None,
        "corner_urad": None,
        "halves_urad": float(1e6 * np.sqrt(np.nanmean(np.sum(apart**2, axis=2)) / 2.0) / first.camera.fx),
        "covered": _agreement(first, second, k),
        "solve_cpu_s": time.process_time() - began,
    }


def _agreement(first: MethodResult, second: MethodResult, k: float) -> dict[str, bool]:
    """Return for each parameter whether two results agree within their joint expanded uncertainty."""
    return {
        name: bool(
            abs(first.camera.to_dict()[name] - second.camera.to_dict()[name])
            <= k * np.hypot(first.sigma[name], second.sigma[name])
        )
        for name in _NAMES
        if name in first.sigma and name in second.sigma
    }


def _calibrated(column: ColumnConfig, views: Sequence[View]) -> tuple[MethodResult, Calibration | None]:
    assert column.data is not None
    if column.method == "zhang":
        return opencv_planar(views, CalibrationOptions("planar", column.lens, "l2")), None
    if column.method == "recipe":
        return published_recipe(views, CalibrationOptions("spherical", column.lens)), None
    calibration = calibrate(views, CalibrationOptions("planar" if column.data.board else "auto", column.lens))
    return starbench_result(calibration), calibration


def _left_out_px(camera: CameraModel, views: Sequence[View]) -> float:
    """Return the rms residual, px, of views that did not enter, with only the pose of the board adjusted by OpenCV."""
    squares = []
    lens = camera.to_dict()
    coefficients = np.array([lens.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3")])
    for view in views:
        points = np.column_stack([view.target_mm, np.zeros(len(view))])
        _, turn, place = cv2.solvePnP(points, view.points_px, camera.matrix, coefficients)
        seen, _ = cv2.projectPoints(points, turn, place, camera.matrix, coefficients)
        squares.append(np.sum((seen.reshape(-1, 2) - view.points_px) ** 2, axis=1))
    return float(np.sqrt(np.mean(np.concatenate(squares))))


def _files(data: DataConfig) -> list[Path]:
    path = Path(data.path)
    return sorted(path.glob("*.txt")) if path.is_dir() else [path] if path.is_file() else []


@lru_cache(maxsize=4)
def _read(description: str, digest: str) -> tuple[View, ...]:
    """Read the views; the digest is there so that changed files are read again."""
    del digest
    data = DataConfig.model_validate_json(description)
    files = _files(data)
    if not files:
        raise BenchError(
            "There are no point files.",
            where=data.path,
            remedy="Correct the path of data in the specification.",
        )
    if files[0].suffix.lower() == ".csv":
        return _read_table(files[0], data)
    from bench.results.point_files import read_point_file

    return tuple(read_point_file(file, image_size=data.image_size, origin=data.origin) for file in files)


def _read_table(file: Path, data: DataConfig) -> tuple[View, ...]:
    """Read the views of one table: time, view, x, y, column and row of the point on the board."""
    if data.pitch_mm is None:
        raise BenchError("A table needs pitch_mm.", where=str(file), remedy="Add it to data.")
    try:
        with storage_errors(file), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of an empty file, which has no six columns either
            table = np.genfromtxt(file, delimiter=",", skip_header=1, ndmin=2)
    except ValueError as error:
        raise BenchError(f"The table cannot be read: {error}.", where=str(file)) from error
    if table.shape[1] != _CSV_COLUMNS or not np.isfinite(table).all():
        raise BenchError(
            "The table does not hold six numbers a line.",
            where=str(file),
            remedy="Write time, view, x, y, column and row of each point, below one line of names.",
        )
    across = int(table[:, 4].max()) + 1
    shift = 0.5 if data.origin == "corner" else 0.0
    views = []
    for number in np.unique(table[:, 1]):
        own = table[table[:, 1] == number]
        ids = (across * own[:, 5] + own[:, 4]).astype(np.int64)
        unit = np.tile(np.eye(2), (len(own), 1, 1))
        place = data.pitch_mm * own[:, 4:6]
        views.append(View(f"view {number:.0f}", data.image_size, ids, own[:, 2:4] - shift, place, unit))
    return tuple(views)
