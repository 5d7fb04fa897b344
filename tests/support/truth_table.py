"""Rows of the table "how right the numbers are": a bench, what its station states, and what is asked of the result.

Each row is calibrated on several drawn benches. The seeds of the table, `SEEDS`, are not those that the engine was
tuned with.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from calib.calibration import CalibrationOptions
from calib.engine import calibrate
from calib.errors import CalibrationError
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from simulators.world.gimbal import GimbalTruth
from simulators.world.truth import ReticleTruth
from tests.support.camera_errors import corner_errors_urad
from tests.support.drawn_benches import NINE, POSES, DrawnBench, draw_repeats

SEEDS = tuple(range(100, 108))
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
    # Smallest and largest expanded uncertainty of fx, px, median over the benches; None for no limit.
    expanded_px: tuple[float, float] | None = None
    corner_urad: float | None = None  # Largest error of a corner, urad; None for no limit

    def __str__(self) -> str:
        """Return the limits as text."""
        parts = [f"error <= {self.error_px:g} px" if self.error_px else "error <= U"]
        if self.expanded_px:
            low, high = self.expanded_px
            parts.append(f"U >= {low:g}" if np.isinf(high) else f"U {low:g} to {high:g}")
        if self.corner_urad:
            parts.append(f"corner <= {self.corner_urad:g} urad")
        return ", ".join(parts)


@dataclass(frozen=True)
class Row:
    """A row of the table."""

    name: str  # Name for the option ``--rows``
    title: str
    profile: str
    poses: int
    options: Choose
    asked: Asked
    times: int = 1
    reticle: ReticleTruth = field(default_factory=ReticleTruth)
    # Whether the readings have errors of .002 degrees alone, and the station states a scale without error.
    only_noise: bool = False


@dataclass(frozen=True)
class Solved:
    """The result of one bench."""

    seed: int
    # error_px, expanded_px: Error and expanded uncertainty of fx, px.
    error_px: float
    expanded_px: float
    corner_urad: float  # Error of the worst corner, urad
    model: str
    notes: tuple[str, ...]


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


def readings(
    bench: DrawnBench, bound: ParallaxBound | None, scale_sigma: float = SCALE_SIGMA
) -> GimbalReadings:
    """Return the readings of a bench as its station states them: .002 degrees.

    bound: Bound of the parallax, if the station states one.
    """
    return GimbalReadings(tuple(bench.readings_deg), 0.002, scale_sigma, 0.001, bound, "drawn")


def _plain(model: str = "auto", radial_sigma: float | None = None) -> Choose:
    """Return options without certificate or readings."""
    return lambda _bench, _rng: CalibrationOptions(model=model, radial_sigma=radial_sigma)  # type: ignore[arg-type]


def _with_readings(off_pivot_mm: float, *, bounded: bool = True, scale_sigma: float = SCALE_SIGMA) -> Choose:
    """Return options with readings; the values of the bound are drawn with their uncertainty."""

    def options(bench: DrawnBench, rng: np.random.Generator) -> CalibrationOptions:
        truth = bench.truth.collimator
        bound = ParallaxBound(
            truth.defocus + 0.01 * rng.normal(), 0.01, off_pivot_mm + 0.5 * rng.normal(), 0.5
        )
        return CalibrationOptions(
            model="auto", gimbal=readings(bench, bound if bounded else None, scale_sigma)
        )

    return options


def _certified(_bench: DrawnBench, rng: np.random.Generator) -> CalibrationOptions:
    """Return options with a certificate, whose value is drawn with its uncertainty."""
    r, sigma = CERTIFICATE_MM
    return CalibrationOptions(model="auto", passport=Passport.of_radius(r + sigma * rng.normal(), sigma))


_READINGS_9 = Asked(2.5, (0.0, 3.0), 150.0)
_READINGS_25 = Asked(1.3, (0.0, 1.5), 60.0)
_CERTIFICATE = Asked(4.0, (4.0, 6.0), 250.0)
_UNBOUND = Asked(None, (60.0, np.inf))

ROWS: Sequence[Row] = (
    Row("ideal", "ideal, 9 poses", "ideal", 9, _plain(), Asked(1.0, (0.0, 1.5), 40.0)),
    Row(
        "ideal-flat",
        "ideal, 9 poses, print flat to 1 um",
        "ideal",
        9,
        _plain(radial_sigma=FLAT),
        Asked(1.0, (0.0, 1.5), 40.0),
    ),
    *(
        Row(
            f"S3{short}{'-noise' if noise else ''}",
            f"S3, readings .002 deg{', noise alone' if noise else ''}, {poses} poses",
            "S3",
            poses,
            _with_readings(0.0, scale_sigma=1e-6 if noise else SCALE_SIGMA),
            asked,
            only_noise=noise,
        )
        for noise in (True, False)
        for short, poses, asked in (("", 9, _READINGS_9), ("-25", 25, _READINGS_25))
    ),
    *(
        Row(
            f"{profile}-certificate", f"{profile}, certificate, 9 poses", profile, 9, _certified, _CERTIFICATE
        )
        for profile in ("S1", "S2", "S3", "like-bench")
    ),
    *(
        Row(
            f"{profile}-unbound",
            f"{profile}, readings without bound, 9 poses",
            profile,
            9,
            _with_readings(0.0, bounded=False),
            _UNBOUND,
        )
        for profile in ("S1", "S2")
    ),
    Row(
        "like-bench",
        "like-bench, readings and bounds, 9 poses",
        "like-bench",
        9,
        _with_readings(2.0),
        Asked(4.0, (0.0, 6.0), 250.0),
    ),
    Row("S1-once", "S1, 9 poses", "S1", 9, _plain(), Asked()),
    Row("S1-repeats", "S1, 9 poses four times", "S1", 9, _plain(), Asked(), times=4),
    *(
        Row(
            f"bow-{bow}-{n}-{model}",
            f"print bowed by {bow} um, {n} poses, {model}",
            "ideal",
            n,
            _plain(model),
            Asked(),
            reticle=ReticleTruth(bow_mm=1e-3 * bow),
        )
        for bow in (10, 50)
        for n in (3, 9)
        for model in ("auto", "radial")
    ),
)
BY_NAME: Mapping[str, Row] = {row.name: row for row in ROWS}


def solve(row: Row, seed: int) -> Solved:
    """Draw a bench of a row, calibrate it and compare with its truth."""
    gimbal = GimbalTruth(reading_sigma_deg=0.002, seed=seed) if row.only_noise else gimbal_errors(seed)
    drawn: dict[str, Any] = {"gimbal": gimbal, "reticle": row.reticle, "common_share": 0.4}
    poses = NINE if row.poses == 9 else POSES[row.poses]
    bench = draw_repeats(row.profile, poses, seed, row.times, **drawn)
    found = calibrate(bench.views, row.options(bench, np.random.default_rng((seed, 12))))
    truth = bench.truth.camera
    return Solved(
        seed,
        found.camera.fx - truth.fx,
        found.coverage_factor * found.sigma["fx"],
        float(corner_errors_urad(found.camera, truth).max()),
        found.model,
        found.notes,
    )


def solve_all(row: Row, seeds: Sequence[int]) -> tuple[list[Solved], list[str]]:
    """Solve a row for several seeds."""
    solved, refused = [], []
    for seed in seeds:
        try:
            solved.append(solve(row, seed))
        except CalibrationError as error:
            refused.append(f"seed {seed}: {error.what}")
    return solved, refused


def shortcomings(row: Row, solved: Sequence[Solved]) -> list[str]:
    """Return in which points results fall short of what their row asks.

    Returns: Sentences; none if all is as asked.
    """
    asked, faults = row.asked, []
    error = max(abs(one.error_px) for one in solved)
    expanded = float(np.median([one.expanded_px for one in solved]))
    corner = max(one.corner_urad for one in solved)
    ratios = np.array([abs(one.error_px) / one.expanded_px for one in solved])
    if asked.error_px is not None and error > asked.error_px:
        faults.append(f"error {error:.2f} px")
    # The limits have one decimal at most.
    if asked.expanded_px and not asked.expanded_px[0] <= round(expanded, 1) <= asked.expanded_px[1]:
        faults.append(f"U {expanded:.2f} px")
    if asked.corner_urad is not None and corner > asked.corner_urad:
        faults.append(f"corner {corner:.0f} urad")
    # Of eight benches, two beyond U or one beyond 1.5 U have a probability of 5 % and 2 % if U is right.
    if (ratios > 1.0).sum() >= 2 or ratios.max() > 1.5:
        faults.append(f"error {ratios.max():.2f} U, {(ratios > 1.0).sum()} benches beyond U")
    return faults
