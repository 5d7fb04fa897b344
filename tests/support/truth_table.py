"""Rows of the table "how right the numbers are": a bench, what its station states, and what is asked of the result.

The seeds of the tests are not those that the engine was tuned with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.calibration import CalibrationOptions
from calib.engine import calibrate
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import ReticleTruth
from tests.support.camera_errors import corner_errors_urad
from tests.support.drawn_benches import NINE, DrawnBench, draw_repeats

#: Standard uncertainty of the scales of the gimbal, as its station states it.
SCALE_SIGMA = 2e-4
CERTIFICATE_MM = (255.0, 0.05)
#: Flatness of a print that is known to a micrometre at 40 mm, as the radial coefficient: bow r / R^2, rectangular.
FLAT = 1e-3 * 255.0 / 40.0**2 / 3.0**0.5

Choose = Callable[[DrawnBench, np.random.Generator], CalibrationOptions]


@dataclass(frozen=True)
class Asked:
    """What a row asks for."""

    error_px: float | None = None  # Largest error of fx, px; None for no limit but U
    expanded_px: float | None = None  # Largest expanded uncertainty of fx, px; None for no limit
    corner_urad: float | None = None  # Largest error of a corner, urad; None for no limit


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    profile: str
    options: Choose
    asked: Asked = field(default_factory=Asked)
    times: int = 1
    bow_mm: float = 0.0  # Bow of the print, mm


@dataclass(frozen=True)
class Solved:
    """The result of one bench."""

    # error_px, expanded_px: Error and expanded uncertainty of fx, px.
    error_px: float
    expanded_px: float
    corner_urad: float  # Error of the worst corner, urad


def gimbal_errors(seed: int) -> GimbalTruth:
    """Draw the errors of a gimbal: all of the simulators' own section.

    Returns: Errors of the sizes that `readings` states.
    """
    rng = np.random.default_rng((seed, 11))
    return GimbalTruth(
        wobble_deg=0.001,
        eccentricity_deg=0.001,
        scale=tuple((SCALE_SIGMA * rng.normal(size=3)).tolist()),
        backlash_deg=(0.001, 0.001, 0.001),
        nonorthogonality_deg=float(0.02 * rng.normal()),
        reading_sigma_deg=0.002,
        seed=seed,
    )


def readings(bench: DrawnBench, bound: ParallaxBound | None) -> GimbalReadings:
    """Return the readings of a bench as its station states them: .002 degrees.

    bound: Bound of the parallax, if the station states one.
    """
    return GimbalReadings(tuple(bench.readings_deg), 0.002, SCALE_SIGMA, 0.001, bound, "drawn")


def _plain(model: str = "auto", radial_sigma: float | None = None) -> Choose:
    """Return options without certificate or readings."""
    return lambda _bench, _rng: CalibrationOptions(model=model, radial_sigma=radial_sigma)  # type: ignore[arg-type]


def _with_readings(off_pivot_mm: float, *, bounded: bool = True) -> Choose:
    """Return options with readings; the values of the bound are drawn with their uncertainty."""

    def options(bench: DrawnBench, rng: np.random.Generator) -> CalibrationOptions:
        truth = bench.truth.collimator
        bound = ParallaxBound(
            truth.defocus + 0.01 * rng.normal(), 0.01, off_pivot_mm + 0.5 * rng.normal(), 0.5
        )
        return CalibrationOptions(model="auto", gimbal=readings(bench, bound if bounded else None))

    return options


def _certified(_bench: DrawnBench, rng: np.random.Generator) -> CalibrationOptions:
    """Return options with a certificate, whose value is drawn with its uncertainty."""
    r, sigma = CERTIFICATE_MM
    return CalibrationOptions(model="auto", passport=Passport.of_radius(r + sigma * rng.normal(), sigma))


_CERTIFICATE = Asked(4.0, 6.0, 250.0)
ROWS: Mapping[str, Row] = {
    "ideal-flat": Row("ideal", _plain(radial_sigma=FLAT), Asked(1.0, 1.5, 40.0)),
    "S3": Row("S3", _with_readings(0.0), Asked(2.5, 3.0, 150.0)),
    "S3-certificate": Row("S3", _certified, _CERTIFICATE),
    "like-bench": Row("like-bench", _with_readings(2.0), Asked(4.0, 6.0, 250.0)),
    "like-bench-certificate": Row("like-bench", _certified, _CERTIFICATE),
    "S1-unbound": Row("S1", _with_readings(0.0, bounded=False)),
    "S1-once": Row("S1", _plain()),
    "S1-repeats": Row("S1", _plain(), times=4),
    "bow-radial": Row("ideal", _plain("radial"), bow_mm=0.05),
}
"""Benches of nine poses, by name."""


def solve(name: str, seed: int) -> Solved:
    """Draw a bench of a row, calibrate it and compare with its truth."""
    row = ROWS[name]
    drawn: dict[str, Any] = {
        "gimbal": gimbal_errors(seed),
        "reticle": ReticleTruth(bow_mm=row.bow_mm),
        "common_share": 0.4,
    }
    bench = draw_repeats(row.profile, NINE, seed, row.times, **drawn)
    found = calibrate(bench.views, row.options(bench, np.random.default_rng((seed, 12))))
    truth = bench.truth.camera
    return Solved(
        found.camera.fx - truth.fx,
        found.coverage_factor * found.sigma["fx"],
        float(corner_errors_urad(found.camera, truth).max()),
    )
