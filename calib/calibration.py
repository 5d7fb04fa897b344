"""What a calibration is asked for and what it answers: options and result, as data.

Knows shapes and names; computes nothing but summaries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from calib.errors import InputMismatch
from calib.model.camera import CameraModel, distortion_names
from calib.model.collimator import Collimator
from calib.model.passport import Passport

Array = NDArray[np.float64]
ModelName = Literal["spherical", "pupil", "rim", "field", "coma", "drift", "planar", "auto"]
LossName = Literal["l2", "huber", "cauchy"]


@dataclass(frozen=True)
class CalibrationOptions:
    """How to calibrate.

    Parameters
    ----------
    model
        ``spherical``: all views share one centre. ``pupil``, ``rim``, ``field``, ``coma``: the same behind a
        collimator with more and more imperfections (`calib.model.aberrations.LADDER`). ``drift``: each view's
        centre may lie off the shared one by `drift_mm`. ``planar``: each view has a centre of its own (Zhang's
        model, for comparison). ``auto``: whichever predicts views it has not seen best.
    distortion
        Names of the coefficients to estimate, or the name of a set in `calib.model.camera.DISTORTION_SETS`.
    loss
        ``l2``, ``huber`` or ``cauchy``, applied to the length of each residual vector.
    huber_px
        Length at which the robust loss leaves the parabola, px; None: 2.5 times the residuals' own robust
        standard deviation per axis.
    max_iterations
        Bound on the steps of the refinement.
    passport
        The collimator, calibrated before: then one view is enough, and `model` is the passport's own.
    guard_band
        Stars farther from the middle of the visible disc than this share of its radius are left out.
    drift_mm
        1-sigma, per axis, of a view's centre about the shared one, for the model ``drift``.

    Raises
    ------
    InputMismatch
        When an option has no meaning.
    """

    model: ModelName = "spherical"
    distortion: str | Sequence[str] = ("k1", "k2")
    loss: LossName = "huber"
    huber_px: float | None = None
    max_iterations: int = 100
    passport: Passport | None = None
    guard_band: float = 1.0
    drift_mm: float = 0.3

    def __post_init__(self) -> None:
        for what, value, known in (
            ("model", self.model, get_args(ModelName)),
            ("loss", self.loss, get_args(LossName)),
        ):
            if value not in known:
                raise InputMismatch(f"Unknown {what} {value!r}.", remedy=f"Known: {', '.join(known)}.")
        object.__setattr__(self, "distortion", distortion_names(self.distortion))
        if self.huber_px is not None and not self.huber_px > 0:
            raise InputMismatch(f"huber_px is {self.huber_px}; it must be positive.")
        if self.max_iterations < 1:
            raise InputMismatch(f"max_iterations is {self.max_iterations}; it must be at least 1.")
        if not 0 < self.guard_band <= 1:
            raise InputMismatch(
                f"guard_band is {self.guard_band}; it must be above 0 and at most 1 (share of the disc's radius)."
            )
        if not self.drift_mm > 0:
            raise InputMismatch(f"drift_mm is {self.drift_mm}; it must be positive.")


@dataclass(frozen=True)
class ViewSummary:
    """How well one view is reproduced.

    Attributes
    ----------
    name
        The view's name.
    n
        Number of stars used.
    rms_px, mean_px
        Root mean square and mean of the lengths of its residual vectors, px.
    """

    name: str
    n: int
    rms_px: float
    mean_px: float


@dataclass(frozen=True)
class Candidate:
    """A model that was fitted while one was to be chosen.

    Attributes
    ----------
    model
        Its name.
    parameters
        Number of parameters, the views' own included.
    rms_px
        Root mean square of the residuals, px.
    left_out_rms_px
        The same for views that had no part in the fit, only their rotation solved; None with two views.
    bic
        Bayesian information criterion; smaller is better.
    """

    model: str
    parameters: int
    rms_px: float
    left_out_rms_px: float | None
    bic: float


@dataclass(frozen=True)
class Calibration:
    """A calibrated camera and all that was estimated with it.

    Attributes
    ----------
    model
        The model fitted.
    camera
        Intrinsics and distortion.
    collimator
        The shared centre; None for the planar model, which has none.
    rotations
        (n, 3, 3) rotation of each view, camera <- target.
    centres
        (n, 3) camera centre of each view in the target frame, mm.
    parameter_names, values
        Names and values of the parameters that all views share.
    covariance
        Joint covariance of those, in their order.
    residuals_px
        For each view (N, 2): star found minus star projected, px.
    weights
        For each view (N,): weight the robust loss gave to each star, 0 to 1; 0 in the guard band.
    rms_px, mean_px
        Root mean square and mean of the lengths of all residual vectors, px. They say how well the model
        follows the data, not how accurate it is.
    variance_factor
        Estimated variance of the weighted residuals: 1 when the stars' covariances tell the truth.
    degrees_of_freedom
        Measurements less parameters.
    disagreement
        How many times their stars' noise the views differ by; 1 is agreement.
    coverage_factor
        k for which value +- k sigma covers 95.45 %: 2, or more where few views stand behind the sigmas.
    left_out_rms_px
        Root mean square residual of views that had no part in the fit, only their rotation solved, px; None
        with fewer than 3 views.
    views
        Summary of each view.
    converged, iterations
        Whether the refinement reached its optimum, and in how many steps.
    rotation_covariance
        (3 n, 3 n) joint covariance of the rotations, rad^2, as turns on the camera's side.
    budget
        1-sigma of each parameter by source; the squares add up to that of `sigma`.
    notes
        What the reader should know, in words.
    candidates
        The models compared, when one was to be chosen.
    """

    model: str
    camera: CameraModel
    collimator: Collimator | None
    rotations: Array
    centres: Array
    parameter_names: tuple[str, ...]
    values: Array
    covariance: Array
    residuals_px: list[Array]
    weights: list[Array]
    rms_px: float
    mean_px: float
    variance_factor: float
    degrees_of_freedom: int
    views: tuple[ViewSummary, ...]
    converged: bool
    iterations: int
    birge_ratio: float = 1.0
    coverage_factor: float = 2.0
    left_out_rms_px: float | None = None
    rotation_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    budget: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    notes: tuple[str, ...] = field(default=())
    candidates: tuple[Candidate, ...] = field(default=())

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard uncertainty (1 sigma) of each parameter, by name."""
        sigmas = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.parameter_names, sigmas.tolist(), strict=True))

    @property
    def camera_covariance(self) -> Array:
        """(k, k) covariance of the camera's parameters, in the order of `CameraModel.parameter_names`."""
        at = [self.parameter_names.index(name) for name in self.camera.parameter_names]
        return np.asarray(self.covariance[np.ix_(at, at)])

    @property
    def correlation(self) -> Array:
        """Correlation matrix of the parameters."""
        sigmas = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(sigmas, sigmas))

    def passport(self, conditions: Mapping[str, Any] | None = None) -> Passport:
        """Return what this calibration knows of the collimator, for other cameras.

        Raises
        ------
        InputMismatch
            For the planar model, which knows no collimator.
        """
        if self.collimator is None:
            raise InputMismatch(
                "The planar model has no collimator parameters.", remedy="Calibrate with another model."
            )
        at = [self.parameter_names.index(name) for name in self.collimator.parameter_names]
        return Passport(
            self.collimator.parameter_names,
            self.values[at],
            self.covariance[np.ix_(at, at)],
            self.collimator.reference,
            self.birge_ratio,
            tuple(view.name for view in self.views),
            conditions or {},
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, lists and names only, ready for JSON."""
        poses = zip(self.views, self.rotations.tolist(), self.centres.tolist(), strict=True)
        return {
            "model": self.model,
            "converged": self.converged,
            "iterations": self.iterations,
            "image_size": list(self.camera.image_size),
            "camera": self.camera.to_dict(),
            "collimator": self.collimator.to_dict() if self.collimator else None,
            "sigma": dict(self.sigma),
            "covariance": {"names": list(self.parameter_names), "matrix": self.covariance.tolist()},
            "rms_px": self.rms_px,
            "mean_px": self.mean_px,
            "variance_factor": self.variance_factor,
            "degrees_of_freedom": self.degrees_of_freedom,
            "disagreement": self.birge_ratio,
            "coverage_factor": self.coverage_factor,
            "left_out_rms_px": self.left_out_rms_px,
            "budget": {source: dict(sigmas) for source, sigmas in self.budget.items()},
            "views": [
                {
                    "name": view.name,
                    "n": view.n,
                    "rms_px": view.rms_px,
                    "mean_px": view.mean_px,
                    "rotation": rotation,
                    "centre_mm": centre,
                }
                for view, rotation, centre in poses
            ],
            "candidates": [asdict(candidate) for candidate in self.candidates],
            "notes": list(self.notes),
        }
