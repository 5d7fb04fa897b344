"""What each method makes of the images of one repetition, compared with the truth; its own stated uncertainty, too."""

from __future__ import annotations

import hashlib
import time
import warnings
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import combinations
from pathlib import Path
from typing import TypedDict, TypeGuard

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.base.errors import BenchError
from bench.compare.scenes import Images
from bench.compare.spec import STAR_METHODS, ColumnConfig, DataConfig
from bench.records.storage import storage_errors
from calib.calibration import Calibration, CalibrationOptions
from calib.engine import calibrate
from calib.errors import CalibrationError
from calib.model.camera import CameraModel
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.rotation import exp_map, log_map, nearest_rotation
from calib.studies.reference_methods import (
    MethodResult,
    calibrate_by_angles,
    opencv_planar,
    published_recipe,
    starbench_result,
)
from calib.target import StarTarget
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty
from calib.view import View

# The result of one method in one repetition, as a line of ``rows.jsonl`` holds it.


class _Row(TypedDict):
    views: int
    missed: Sequence[str]  # For each image without a view, the reason
    images_cpu_s: float  # Time to record the images and to find their targets


class FailedRow(_Row):
    """A repetition without a result, and the reason."""

    error: str


class _Numbers(TypedDict):
    camera: Mapping[str, float]
    sigma: Mapping[str, float]
    k: float
    model: str | None  # Of the engine; other methods have no choice of models
    rms_px: float
    mean_px: float
    left_out_px: float | None


class Distances(TypedDict):
    """Distances from the truth after the best common rotation, for a camera turned a little is the same.

    Recorded data have no truth: only ``covered``, there whether two parts of them agree.
    """

    errors: Mapping[str, float]  # By parameter
    direction_rms_urad: float | None
    direction_worst_urad: float | None
    centre_urad: float | None
    corner_urad: float | None  # Largest of the corners
    covered: dict[str, bool]  # Whether the error is within k sigma; ``corner`` is that of largest uncertainty


class _Solved(_Row, _Numbers, Distances):
    solve_cpu_s: float


class SimulatedRow(_Solved):
    """A result from simulated images."""

    gimbal_ratio_error: float | None


class DataRow(_Solved):
    """A result from recorded data."""

    halves_urad: float  # Rms difference of the two parts, for one of them


SolvedRow = SimulatedRow | DataRow
Row = FailedRow | SolvedRow


def is_failed(row: Row) -> TypeGuard[FailedRow]:
    """Return whether a repetition has no result."""
    return "error" in row


def solved(rows: Sequence[Row]) -> list[SolvedRow]:
    """Return the rows that have a result."""
    return [row for row in rows if "error" not in row]


# What a bench shows without the truth: the gimbal's angles as a check from outside, and the time that
# images take.
#
# A star is the same direction in every image, so the rotation between two images follows from the camera
# alone: no collimator enters. With a focal length that is too long by some share, the camera seems to turn
# less by that share.

Array = NDArray[np.float64]

#: Seconds of a run on the simulated bench: before the first pose, and for each (move, settle, record), as planned.
_BEFORE_S, _POSE_S = 3.2, 2.3
#: Seconds in which a person places a board, or moves a camera past it: an assumption.
_PLACEMENT_S, _PASS_S = 20.0, 2.0
_FEWEST_COMMON = 12
_SMALLEST_TURN_DEG = 1.0


def bench_time_s(column: ColumnConfig) -> float:
    """Return how long, s, the images of a column keep a bench busy: 20 s a board, 2 s a moving picture (assumed)."""
    if column.method in STAR_METHODS:
        return _BEFORE_S + column.images * _POSE_S
    return column.images * (_PASS_S if column.method == "reconstruction" else _PLACEMENT_S)


def gimbal_ratio_error(
    camera: CameraModel, views: Sequence[View], readings_deg: Sequence[Mapping[str, float]]
) -> float | None:
    """Return by what share the camera turns more than the gimbal says; None without two views and readings.

    Rotation between two images by Kabsch (1976), from common stars; pairs of poses are weighted by the squared angle.
    """
    if len(readings_deg) != len(views):
        return None
    product, square = 0.0, 0.0
    for first, second in combinations(range(len(views)), 2):
        read = _turn(_gimbal(readings_deg[first]).T @ _gimbal(readings_deg[second]))
        _, at_first, at_second = np.intersect1d(views[first].ids, views[second].ids, return_indices=True)
        if len(at_first) < _FEWEST_COMMON or read < np.radians(_SMALLEST_TURN_DEG):
            continue
        rays_first, rays_second = (
            camera.rays(view.points_px[at])
            for view, at in ((views[first], at_first), (views[second], at_second))
        )
        seen = _turn(nearest_rotation(_unit(rays_first).T @ _unit(rays_second)))
        product += seen * read
        square += read * read
    return product / square - 1.0 if square else None


def _gimbal(angles_deg: Mapping[str, float]) -> Array:
    """Return the rotation of a gimbal: pan about the vertical axis carries tilt about the horizontal one."""
    pan, tilt = (np.radians(angles_deg.get(f"{axis}_deg", 0.0)) for axis in ("pan", "tilt"))
    return exp_map(np.array([0.0, pan, 0.0])) @ exp_map(np.array([tilt, 0.0, 0.0]))


def _unit(rays: Array) -> Array:
    return np.asarray(rays / np.linalg.norm(rays, axis=1)[:, None])


def _turn(rotation: Array) -> float:
    """Return the angle of a rotation, rad."""
    return float(np.linalg.norm(log_map(rotation)))


# Columns on recorded data: calibrations of random subsets of real views, of which no truth is known.
#
# Each repetition draws two disjoint subsets. Their difference shows whether the stated uncertainties hold
# as far as two parts of the same data can show it: an error that both share, such as that of the
# collimator, stays hidden.

_CSV_COLUMNS = 6
_ACROSS = 17
_K = 2.0
_NAMES = ("fx", "fy", "cx", "cy")


def data_digest(data: DataConfig) -> str:
    """Return a hash of the files of recorded data, by which rows are made again; ``missing`` if there are none."""
    files = _files(data)
    if not files:
        return "missing"
    content = hashlib.sha256()
    with storage_errors(Path(data.path)):
        for file in files:
            content.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    return content.hexdigest()


def read_data(data: DataConfig) -> tuple[View, ...]:
    """Read all views, in order of their names or numbers."""
    return _read(data.model_dump_json(), data_digest(data))


def solve_data(column: ColumnConfig, seed: int) -> Row:
    """Calibrate two random disjoint subsets of views: camera, sigmas, residuals, and their difference."""
    began = time.process_time()
    assert column.data is not None
    try:
        views = read_data(column.data)
        if len(views) < 2 * column.images:
            return _failed_data(f"{len(views)} views are too few for two subsets of {column.images}")
        order = np.random.default_rng((seed, 41)).permutation(len(views))
        parts = [
            [views[i] for i in sorted(order[start : start + column.images])] for start in (0, column.images)
        ]
        (first, found), (second, _) = (_calibrated(column, part) for part in parts)
    except (BenchError, CalibrationError) as error:
        return _failed_data(str(error))
    numbers = _numbers(first, found)
    if column.data.board:
        numbers["left_out_px"] = _left_out_px(first.camera, parts[1])
    apart = np.asarray(camera_difference(second.camera, first.camera, _ACROSS).offset_px)
    return {
        "views": column.images,
        "missed": [],
        "images_cpu_s": 0.0,
        **numbers,
        "errors": {},
        "direction_rms_urad": None,
        "direction_worst_urad": None,
        "centre_urad": None,
        "corner_urad": None,
        "halves_urad": float(1e6 * np.sqrt(np.nanmean(np.sum(apart**2, axis=2)) / 2.0) / first.camera.fx),
        "covered": _agreement(first, second, numbers["k"]),
        "solve_cpu_s": time.process_time() - began,
    }


def _failed_data(why: str) -> FailedRow:
    return {"views": 0, "missed": [], "images_cpu_s": 0.0, "error": why}


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
    from bench.results.offline_options import read_point_file

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


#: The certificate that a column with ``passport`` has: radius and its standard uncertainty, mm.
CERTIFICATE_MM = (255.0, 0.05)
#: The focal length of a catalogue, which the method ``angles`` uses without a certificate: 1 % is a usual tolerance.
CATALOGUE_MM = (255.0, 2.55)
#: How far the entrance pupil stands before the pivot, where it is known; other collimators have no bound of parallax.
_OFF_PIVOT_MM = {"ideal": 0.0, "S3": 0.0, "like-bench": 2.0}
_FEWEST_VIEWS = 2
#: Radius at which the flatness of a reticle is stated, mm; its radial coefficient is bow r / R^2, rectangular.
_FLAT_AT_MM = 40.0


def solve(column: ColumnConfig, images: Images, images_cpu_s: float, seed: int) -> Row:
    """Calibrate by the method of a column: values, sigmas, errors and residuals."""
    if len(images.views) < (1 if column.known_collimator or column.method == "angles" else _FEWEST_VIEWS):
        reasons = "; ".join(dict.fromkeys(images.missed)) or "no image"
        return failed_row(images, images_cpu_s, f"{len(images.views)} views with a target: {reasons}")
    began = time.process_time()
    try:
        result, calibration = _result(column, images, seed)
    except CalibrationError as error:
        return failed_row(images, images_cpu_s, str(error))
    solve_cpu_s = time.process_time() - began
    numbers = _numbers(result, calibration)
    return {
        "views": len(images.views),
        "missed": list(images.missed),
        "solve_cpu_s": solve_cpu_s,
        **numbers,
        "gimbal_ratio_error": gimbal_ratio_error(result.camera, images.views, images.readings_deg),
        **compare_with_truth(result.camera, images.camera, result.sigma, numbers["k"], calibration),
        "images_cpu_s": images_cpu_s,
    }


def failed_row(images: Images, images_cpu_s: float, why: str) -> FailedRow:
    """Return the row of images of which a method makes nothing."""
    return {
        "views": len(images.views),
        "missed": list(images.missed),
        "error": why,
        "images_cpu_s": images_cpu_s,
    }


def _numbers(result: MethodResult, calibration: Calibration | None) -> _Numbers:
    """Return what a row of any column states about a result, and the engine's calibration if it is the engine's."""
    return {
        "camera": result.camera.to_dict(),
        "sigma": dict(result.sigma),
        "k": calibration.coverage_factor if calibration is not None else _K,
        "model": calibration.model if calibration is not None else None,
        "rms_px": result.rms_px,
        "mean_px": result.mean_px,
        "left_out_px": result.left_out_rms_px,
    }


def compare_with_truth(
    found: CameraModel,
    true: CameraModel,
    sigma: Mapping[str, float],
    k: float,
    calibration: Calibration | None = None,
) -> Distances:
    """Compare a calibrated camera with the true one; the worst corner needs the covariance of a ``calibration``."""
    offset = np.asarray(camera_difference(found, true, _ACROSS).offset_px)
    away = np.linalg.norm(offset, axis=2) / true.fx * 1e6
    corners = away[[0, 0, -1, -1], [0, -1, 0, -1]]
    errors = {
        name: found.to_dict()[name] - value
        for name, value in true.to_dict().items()
        if name in found.to_dict()
    }
    compared: Distances = {
        "errors": errors,
        "direction_rms_urad": float(np.sqrt(np.nanmean(away**2))),
        "direction_worst_urad": float(np.nanmax(away)),
        "centre_urad": float(away[away.shape[0] // 2, away.shape[1] // 2]),
        "corner_urad": float(np.nanmax(corners)),
        "covered": {
            name: bool(abs(errors[name]) <= k * sigma[name])
            for name in ("fx", "fy", "cx", "cy")
            if name in sigma
        },
    }
    if calibration is not None:
        stated = projection_uncertainty(calibration.camera, calibration.camera_covariance, _ACROSS).sigma_px
        place = np.unravel_index(int(np.nanargmax(stated)), stated.shape)
        compared["covered"]["corner"] = bool(away[place] <= k * stated[place] / true.fx * 1e6)
    return compared


def _result(column: ColumnConfig, images: Images, seed: int) -> tuple[MethodResult, Calibration | None]:
    """Return the result of the column's method, and the engine's calibration if it is the engine's."""
    views = images.views
    lens = column.lens
    if column.method == "recipe":
        return published_recipe(views, CalibrationOptions("spherical", lens)), None
    if column.method == "angles":
        return _by_angles(column, images, seed), None
    board = column.method not in STAR_METHODS
    if column.method == "zhang" or (board and column.detector != "symmetry"):
        return opencv_planar(views, CalibrationOptions("planar", lens, "l2")), None
    if board:
        calibration = calibrate(views, CalibrationOptions("planar", lens))
    else:
        calibration = calibrate(views, _options(column, images, seed))
    return starbench_result(calibration), calibration


def _by_angles(column: ColumnConfig, images: Images, seed: int) -> MethodResult:
    """Calibrate from one image, with the collimator's focal length of its certificate or of a catalogue."""
    r, sigma = CERTIFICATE_MM if column.passport else CATALOGUE_MM
    stated = r + sigma * np.random.default_rng((seed, 13)).normal()
    x, y = StarTarget().tag_centre_mm
    return calibrate_by_angles(images.views[0], stated, (float(x), float(y)), column.lens)


def _options(column: ColumnConfig, images: Images, seed: int) -> CalibrationOptions:
    """Return what the engine is told: a certificate and readings whose stated values are drawn with their sigmas."""
    rng = np.random.default_rng((seed, 12))
    r, sigma = CERTIFICATE_MM
    certified = r + sigma * rng.normal()
    defocus, off_pivot = 0.01 * rng.normal(), 0.5 * rng.normal()
    bound = None
    if column.collimator in _OFF_PIVOT_MM:
        stated = float(images.truth["collimator"]["defocus"]) + defocus
        bound = ParallaxBound(stated, 0.01, _OFF_PIVOT_MM[column.collimator] + off_pivot, 0.5)
    flat = None if column.flatness_um is None else 1e-3 * column.flatness_um * r / _FLAT_AT_MM**2 / 3.0**0.5
    if column.known_collimator and images.reference is not None:
        first = column.model_copy(update={"known_collimator": None, "passport": True, "readings": True})
        known = calibrate(images.reference.views, _options(first, images.reference, seed))
        return CalibrationOptions(model="auto", distortion=column.lens, passport=known.passport({}))
    angles = tuple(dict(one) for one in images.readings_deg)
    return CalibrationOptions(
        model="auto",
        distortion=column.lens,
        radial_sigma=flat,
        passport=Passport.of_radius(certified, sigma) if column.passport else None,
        gimbal=GimbalReadings(angles, 0.002, 2e-4, 0.001, bound, "drawn") if column.readings else None,
    )
