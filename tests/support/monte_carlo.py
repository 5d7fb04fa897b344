"""Monte Carlo studies: a calibration repeated on predicted views with noise, to test the stated uncertainties.

The principle is that of JCGM 101:2008. Each run has its own random seed, so that it can be repeated.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib import CalibrationOptions, Collimator, ExpectedBench, View, calibrate, predicted_view
from calib.arrays import Array
from calib.errors import CalibrationError, NotConverged
from calib.model.result_parts import COVERAGE

#: Probability of the band in which the observed coverage must lie.
_BAND = 0.999
#: 1-sigma per axis of an outlier.
_OUTLIER_SIGMA_PX = 2.0


@dataclass(frozen=True)
class MonteCarloStudy:
    """Results of repeated calibrations."""

    names: tuple[str, ...]
    truth: Array  # (G,) float64 true values
    # values, sigmas: (runs, G) float64 estimates and their stated standard uncertainties.
    values: Array
    sigmas: Array
    factors: Array  # (runs, G) float64 stated coverage factors k
    failed: tuple[str, ...]  # Reason for each run without a calibration

    @property
    def scatter(self) -> Mapping[str, float]:
        """Root mean square error of each parameter."""
        rms = np.sqrt(((self.values - self.truth) ** 2).mean(axis=0))
        return dict(zip(self.names, rms.tolist(), strict=True))

    @property
    def z_rms(self) -> Mapping[str, float]:
        """Root mean square of error over stated sigma; 1 if the sigmas are right."""
        z = (self.values - self.truth) / self.sigmas
        return dict(zip(self.names, np.sqrt((z**2).mean(axis=0)).tolist(), strict=True))

    @property
    def coverage(self) -> Mapping[str, float]:
        """Share of runs in which value +- k sigma covers the truth."""
        covered = np.abs(self.values - self.truth) <= self.factors * self.sigmas
        return dict(zip(self.names, covered.mean(axis=0).tolist(), strict=True))

    @property
    def coverage_band(self) -> tuple[float, float]:
        """Band in which the coverage of right sigmas lies in 999 of 1000 studies (binomial distribution)."""
        from scipy import stats

        low, high = stats.binom.interval(_BAND, len(self.values), COVERAGE)
        return float(low) / len(self.values), float(high) / len(self.values)


@dataclass(frozen=True)
class Repetition:
    """One calibration of a study."""

    names: tuple[str, ...] = ()
    values: tuple[float, ...] = ()
    sigmas: tuple[float, ...] = ()
    factors: tuple[float, ...] = ()
    failed: str = ""  # Why there is no calibration; empty if there is one


def calibrate_once(
    bench: ExpectedBench,
    poses_deg: Sequence[Mapping[str, float]],
    options: CalibrationOptions,
    seed: int,
    run: int,
    *,
    drift_mm: float = 0.0,
    outliers: float = 0.0,
) -> Repetition:
    """Calibrate predicted views with the noise of one run, from 0, of a study; return the result, or why there is none.

    Draws: JCGM 101:2008. Seed of the study and number of the run give the run's seed. ``drift_mm`` is 1-sigma per axis
    of each view's centre; ``outliers`` is the share of stars with an error of 2 px (1 sigma per axis).
    """
    rng = np.random.default_rng([seed, run])
    try:
        result = calibrate(_noisy(bench, poses_deg, rng, drift_mm, outliers), options)
    except CalibrationError as error:
        return Repetition(failed=str(error))
    names, sigmas = tuple(result.parameter_names), tuple(result.sigma.values())
    factors = tuple(result.coverage_factors.get(name, result.coverage_factor) for name in names)
    return Repetition(names, tuple(result.estimates.tolist()), sigmas, factors)


def study_of(bench: ExpectedBench, outcomes: Sequence[Repetition]) -> MonteCarloStudy:
    """Put the runs of a study together, in their order; at least one must have a result."""
    good = [outcome for outcome in outcomes if not outcome.failed]
    failed = tuple(outcome.failed for outcome in outcomes if outcome.failed)
    if not good:
        raise NotConverged(
            f"None of the {len(outcomes)} calibrations has a result. The first one: {failed[0]}",
            remedy="Give less noise, fewer outliers, or more poses.",
        )
    kinds, true = ("values", "sigmas", "factors"), {**bench.camera.to_dict(), **bench.collimator.to_dict()}
    values, sigmas, factors = (np.array([getattr(outcome, kind) for outcome in good]) for kind in kinds)
    truth = np.array([true.get(name, 0.0) for name in good[-1].names])  # what the bench does not have is zero
    return MonteCarloStudy(good[-1].names, truth, values, sigmas, factors, failed)


def _noisy(
    bench: ExpectedBench,
    poses_deg: Sequence[Mapping[str, float]],
    rng: np.random.Generator,
    drift_mm: float,
    outliers: float,
) -> list[View]:
    """Return noisy views (own model): Gaussian noise of stars and centres, and outliers of a wider Gaussian."""
    views = []
    for i, pose in enumerate(poses_deg, start=1):
        centre = bench.collimator.values[:3] + drift_mm * rng.standard_normal(3)
        moved = replace(bench, collimator=Collimator(*centre.tolist()))
        view, _ = predicted_view(moved, pose, f"pose {i}")
        noise = bench.star_sigma_px * rng.standard_normal(view.points_px.shape)
        if outliers:
            bad = rng.random(len(view)) < outliers
            noise[bad] = _OUTLIER_SIGMA_PX * rng.standard_normal((int(bad.sum()), 2))
        views.append(replace(view, points_px=view.points_px + noise))
    return views
