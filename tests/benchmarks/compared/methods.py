"""What each method makes of the images of one repetition, compared with the truth; its own stated uncertainty, too."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from calib import Calibration, CalibrationOptions, CameraModel, Passport, StarTarget, calibrate
from calib.errors import CalibrationError
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.uncertainty.projection_uncertainty import camera_difference, projection_uncertainty
from tests.benchmarks.compared.reference_methods import (
    MethodResult,
    opencv_planar,
    published_recipe,
    starbench_result,
)
from tests.benchmarks.worlds.knowledge import options_for

from .by_others import calibrate_by_angles
from .columns import STAR_METHODS, Column
from .gimbal_check import gimbal_ratio_error
from .scenes import Images, find_targets, finding_key, record

Row = dict[str, Any]
"""The result of one method in one repetition, or ``error``: the reason why there is none."""


def rows_of(columns: Sequence[Column], seed: int) -> dict[str, Row]:
    """Apply the method of each column to the images that all of them share; return the rows by the columns' names."""
    try:
        began = time.process_time()
        recorded = record(columns[0], seed)
        record_cpu_s = time.process_time() - began
    except CalibrationError as error:
        return {column.name: {"error": str(error), "views": 0} for column in columns}
    images: dict[Any, tuple[Images, float]] = {}
    rows = {}
    for column in columns:
        how = finding_key(column)
        if how not in images:
            began = time.process_time()
            images[how] = find_targets(column, recorded), record_cpu_s + time.process_time() - began
        rows[column.name] = solve(column, *images[how], seed)
    return rows


#: Points of the grid on which cameras are compared; expansion factor of methods that state none.
_ACROSS = 17
_K = 2.0
#: The certificate that a column with ``passport`` has: radius and its standard uncertainty, mm.
CERTIFICATE_MM = (255.0, 0.05)
#: The focal length of a catalogue, which the method ``angles`` uses without a certificate: 1 % is a usual tolerance.
CATALOGUE_MM = (255.0, 2.55)
#: How far the entrance pupil stands before the pivot, where it is known; other collimators have no bound of parallax.
_OFF_PIVOT_MM = {"ideal": 0.0, "S3": 0.0, "like-bench": 2.0}
_FEWEST_VIEWS = 2


def solve(column: Column, images: Images, images_cpu_s: float, seed: int) -> Row:
    """Calibrate by the method of a column: values, sigmas, errors and residuals."""
    count = len(images.views)
    if count < (1 if column.known_collimator or column.method == "angles" else _FEWEST_VIEWS):
        reasons = "; ".join(dict.fromkeys(images.missed)) or "no image"
        return failed_row(images, images_cpu_s, f"{count} views with a target: {reasons}")
    began = time.process_time()
    try:
        result, calibration = _result(column, images, seed)
    except CalibrationError as error:
        return failed_row(images, images_cpu_s, str(error))
    solve_cpu_s = time.process_time() - began
    numbers = _numbers(result, calibration)
    return {
        "views": count,
        "missed": list(images.missed),
        "solve_cpu_s": solve_cpu_s,
        **numbers,
        "gimbal_ratio_error": gimbal_ratio_error(result.camera, images.views, images.readings_deg),
        **compare_with_truth(result.camera, images.camera, result.sigma, numbers["k"], calibration),
        "images_cpu_s": images_cpu_s,
    }


def failed_row(images: Images, images_cpu_s: float, why: str) -> Row:
    """Return the row of images of which a method makes nothing."""
    row = {"views": len(images.views), "missed": list(images.missed)}
    return {**row, "error": why, "images_cpu_s": images_cpu_s}


def _numbers(result: MethodResult, calibration: Calibration | None) -> Row:
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
    camera: CameraModel,
    true: CameraModel,
    sigma: Mapping[str, float],
    k: float,
    calibration: Calibration | None = None,
) -> Row:
    """Compare a calibrated camera with the true one; the worst corner needs the covariance of a ``calibration``."""
    offset = np.asarray(camera_difference(camera, true, _ACROSS).offset_px)
    off_urad = np.linalg.norm(offset, axis=2) / true.fx * 1e6
    corners = off_urad[[0, 0, -1, -1], [0, -1, 0, -1]]
    found, truths = camera.to_dict(), true.to_dict()
    errors = {name: found[name] - truths[name] for name in truths if name in found}
    compared: Row = {
        "errors": errors,
        "direction_rms_urad": float(np.sqrt(np.nanmean(off_urad**2))),
        "direction_worst_urad": float(np.nanmax(off_urad)),
        "centre_urad": float(off_urad[off_urad.shape[0] // 2, off_urad.shape[1] // 2]),
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
        compared["covered"]["corner"] = bool(off_urad[place] <= k * stated[place] / true.fx * 1e6)
    return compared


def _result(column: Column, images: Images, seed: int) -> tuple[MethodResult, Calibration | None]:
    """Return the result of the column's method, and the engine's calibration if it is the engine's."""
    views = images.views
    lens = column.lens
    if column.method == "recipe":
        return published_recipe(views, CalibrationOptions("spherical", lens)), None
    if column.method == "angles":
        return _by_angles(column, images, seed), None
    board = column.method not in STAR_METHODS
    if column.method == "zhang":
        return opencv_planar(views, CalibrationOptions("planar", lens, "l2")), None
    if board:
        calibration = calibrate(views, CalibrationOptions("planar", lens))
    else:
        calibration = calibrate(views, _options(column, images, seed))
    return starbench_result(calibration), calibration


def _by_angles(column: Column, images: Images, seed: int) -> MethodResult:
    """Calibrate from one image, with the collimator's focal length of its certificate or of a catalogue."""
    r, sigma = CERTIFICATE_MM if column.passport else CATALOGUE_MM
    stated = r + sigma * np.random.default_rng((seed, 13)).normal()
    x, y = StarTarget().tag_centre_mm
    return calibrate_by_angles(images.views[0], stated, (float(x), float(y)), column.lens)


def _options(column: Column, images: Images, seed: int) -> CalibrationOptions:
    """Return what the engine is told: a certificate and readings whose stated values are drawn with their sigmas."""
    if images.bench is not None:
        known = ("c" if column.passport else "") + ("r" if column.readings else "")
        return options_for(images.bench, known or "0", "right")
    rng = np.random.default_rng((seed, 12))
    r, sigma = CERTIFICATE_MM
    certified = r + sigma * rng.normal()
    defocus, off_pivot = 0.01 * rng.normal(), 0.5 * rng.normal()
    bound = None
    if column.collimator in _OFF_PIVOT_MM:
        stated = float(images.truth["collimator"]["defocus"]) + defocus
        bound = ParallaxBound(stated, 0.01, _OFF_PIVOT_MM[column.collimator] + off_pivot, 0.5)
    if column.known_collimator and images.reference is not None:
        first = column.model_copy(update={"known_collimator": None, "passport": True, "readings": True})
        known = calibrate(images.reference.views, _options(first, images.reference, seed))
        return CalibrationOptions(model="auto", distortion=column.lens, passport=known.passport({}))
    angles = tuple(dict(readings) for readings in images.readings_deg)
    return CalibrationOptions(
        model="auto",
        distortion=column.lens,
        passport=Passport.of_radius(certified, sigma) if column.passport else None,
        gimbal=GimbalReadings(angles, 0.002, 2e-4, 0.001, bound, "drawn") if column.readings else None,
    )
