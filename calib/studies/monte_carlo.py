"""Monte Carlo studies: a calibration repeated many times on imagined views, to see whether its sigmas are true.

Knows an imagined bench, noise, and how often an interval should cover. The random generator comes from outside: one
seed a run, so any run can be had again alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib.calibration import CalibrationOptions
from calib.engine import calibrate
from calib.errors import CalibrationError
from calib.model.collimator import Collimator
from calib.studies.predicted_views import ExpectedBench, predicted_view
from calib.view import View

Array = NDArray[np.float64]

#: Nominal coverage of value +- k sigma, and the probability of the band in which the observed coverage must lie.
COVERAGE = 0.9545
_BAND = 0.999
#: 1-sigma per axis of an outlier.
_OUTLIER_SIGMA_PX = 2.0


@dataclass(frozen=True)
class MonteCarloStudy:
    """What repeated calibrations showed.

    Attributes
    ----------
    names
        The parameters.
    truth
        (G,) their true values.
    values, sigmas
        (runs, G) estimates, and the uncertainties stated with them.
    factors
        (runs,) the coverage factors k stated with them: 2, or more where views disagree.
    chi_squares
        (runs,) squared error by the covariance stated: G in the mean when it is true, correlations and all.
    failed
        For each run that gave no calibration, why.
    """

    names: tuple[str, ...]
    truth: Array
    values: Array
    sigmas: Array
    factors: Array
    chi_squares: Array
    failed: tuple[str, ...]

    @property
    def scatter(self) -> Mapping[str, float]:
        """Root mean square error of each parameter."""
        rms = np.sqrt(((self.values - self.truth) ** 2).mean(axis=0))
        return dict(zip(self.names, rms.tolist(), strict=True))

    @property
    def z_rms(self) -> Mapping[str, float]:
        """Root mean square of error over stated sigma: 1 when the sigmas are true."""
        z = (self.values - self.truth) / self.sigmas
        return dict(zip(self.names, np.sqrt((z**2).mean(axis=0)).tolist(), strict=True))

    @property
    def z_joint(self) -> float:
        """Root mean square of all errors together by the stated covariance: the sharpest test a study has of it."""
        return float(np.sqrt(self.chi_squares.mean() / len(self.names)))

    @property
    def coverage(self) -> Mapping[str, float]:
        """Share of runs in which value +- k sigma covered the truth."""
        covered = np.abs(self.values - self.truth) <= self.factors[:, None] * self.sigmas
        return dict(zip(self.names, covered.mean(axis=0).tolist(), strict=True))

    @property
    def coverage_band(self) -> tuple[float, float]:
        """Band that the coverage of true sigmas keeps in 999 of 1000 studies (binomial)."""
        from scipy import stats

        low, high = stats.binom.interval(_BAND, len(self.values), COVERAGE)
        return float(low) / len(self.values), float(high) / len(self.values)


def run_monte_carlo(
    bench: ExpectedBench,
    poses_deg: Sequence[Mapping[str, float]],
    options: CalibrationOptions,
    runs: int,
    seed: int,
    *,
    drift_mm: float = 0.0,
    outliers: float = 0.0,
    progress: Callable[[int, int], None] | None = None,
) -> MonteCarloStudy:
    """Calibrate imagined views again and again, with new noise each time.

    Parameters
    ----------
    bench, poses_deg
        The world: camera, collimator, beam, star noise; and the poses.
    options
        How to calibrate.
    runs, seed
        How many times, and the seed that with a run's number makes its noise.
    drift_mm
        1-sigma, per axis, by which each view's centre lies off the shared one.
    outliers
        Share of the stars that are grossly wrong: by 2 px, 1 sigma per axis.
    progress
        Told after each run its number, and of how many.
    """
    truth = {**bench.camera.to_dict(), **bench.collimator.to_dict()}
    values: list[Array] = []
    sigmas: list[list[float]] = []
    factors: list[float] = []
    chi_squares: list[float] = []
    failed: list[str] = []
    names: tuple[str, ...] = ()
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        try:
            result = calibrate(_noisy(bench, poses_deg, rng, drift_mm, outliers), options)
        except CalibrationError as error:
            failed.append(str(error))
        else:
            names = result.parameter_names
            values.append(result.values)
            sigmas.append(list(result.sigma.values()))
            factors.append(result.coverage_factor)
            off = (result.values - [truth[name] for name in names]) / sigmas[-1]
            chi_squares.append(float(off @ np.linalg.solve(result.correlation, off)))
        if progress:
            progress(run + 1, runs)
    true = np.array([truth[name] for name in names])
    numbers = (np.array(values), np.array(sigmas), np.array(factors), np.array(chi_squares))
    return MonteCarloStudy(names, true, *numbers, tuple(failed))


def _noisy(
    bench: ExpectedBench,
    poses_deg: Sequence[Mapping[str, float]],
    rng: np.random.Generator,
    drift_mm: float,
    outliers: float,
) -> list[View]:
    """Return views with noise, each about a centre of its own."""
    views = []
    for i, pose in enumerate(poses_deg, start=1):
        x, y, r = bench.collimator.values[:3] + drift_mm * rng.standard_normal(3)
        moved = replace(bench, collimator=Collimator(float(x), float(y), float(r)))
        view, _ = predicted_view(moved, pose, f"pose {i}")
        noise = bench.star_sigma_px * rng.standard_normal(view.points_px.shape)
        if outliers:
            bad = rng.random(len(view)) < outliers
            noise[bad] = _OUTLIER_SIGMA_PX * rng.standard_normal((int(bad.sum()), 2))
        views.append(replace(view, points_px=view.points_px + noise))
    return views
