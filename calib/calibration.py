"""Options and result of a calibration, as data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, get_args

import numpy as np

from calib.adjustment.loss import LossName
from calib.arrays import Array, ReadOnlyArrays
from calib.errors import InputMismatch, require_known
from calib.model.camera import CameraModel, distortion_names
from calib.model.cause import Cause
from calib.model.collimator import Collimator
from calib.model.gimbal_readings import GimbalReadings
from calib.model.passport import Passport
from calib.model.result_parts import Amplitude, Boresight, BudgetRow, GimbalEstimate, RotationErrors, Witness
from calib.model.result_table import ParameterRow, as_frame, as_html, as_text
from calib.model.target_focus import TargetFocus
from calib.model.type_b_terms import TypeBTerm

ModelName = Literal["auto", "joint", "spherical", "planar"]
#: Methods for comparison: the spherical model of arXiv:2512.16092, and Zhang's.
REFERENCE_MODELS = ("spherical", "planar")
#: What is estimated if nothing is asked for; the joint adjustment takes it as the family of such lenses.
DEFAULT_DISTORTION = ("k1", "k2")
#: The revision of each engine, raised when a value or an uncertainty changes, by its stars or its adjustment:
#: `verify --again` confirms what another revision made only if the numbers agree.
ENGINES = {"joint": 47, "reference": 3}


_ONLY_JOINT = {
    "gimbal": "the readings of the gimbal",
    "budget": "the uncertainties of the budget",
    "radial_sigma": "the prior of the radial term",
    "focus": "the focus of the target",
    "compares_lenses": "the choice of a lens model (auto); name the coefficients",
}
_ONLY_REFERENCE = {"loss": "the loss", "huber_px": "the limit of the loss"}
"""Options that only one kind of model uses, in words. A method of reference refuses a passport."""


@dataclass(frozen=True)
class CalibrationOptions:
    """How to calibrate.

    Parameters
    ----------
    model
        ``auto``, ``joint``: every effect is a parameter with a prior (`calib.joint`). For comparison: ``spherical``:
        all views share one centre. ``planar``: each view has its own centre (Zhang's model).
    distortion
        Names of the coefficients to estimate, or the name of a set in `calib.model.camera.DISTORTION_SETS`. The joint
        adjustment estimates at least k1 to k3, p1 and p2, or all kb, and says so if fewer were asked for. ``auto``: it
        chooses between these two families.
    loss
        ``l2``, ``huber`` or ``cauchy``; it acts on the length of each residual vector. None for ``huber``.
    huber_px
        Length at which the robust loss leaves the parabola, px; None for 2.5 times the robust standard deviation per
        axis of the residuals.
    passport
        Passport of the collimator; one view is then enough. A certificate states the radius alone.
    guard_band
        Stars farther from the centre of the visible disc than this share of its radius are left out.
    gimbal
        Readings of the gimbal, one for each view in their order.
    radial_sigma
        Prior 1-sigma of the radial term of the target's map, if the bench states it (bow of the reticle and distortion
        of the collimator); None for what is typical of real collimators.
    budget
        Type B terms of the uncertainty budget.
    passport_source
        Where the passport comes from, for its row of the budget.
    focus
        The target's focus and the place of the pupil: how a certified focal length and what the camera sees differ. The
        defocus of a bound of the parallax counts as this one. None: what is typical of benches.
    compares_lenses
        Whether the data choose the family of the lens; so they do if `distortion` is ``auto``.

    Raises
    ------
    InputMismatch
        If an option is unknown or out of range.
    """

    model: ModelName = "auto"
    distortion: str | Sequence[str] = DEFAULT_DISTORTION
    loss: LossName | None = None
    huber_px: float | None = None
    passport: Passport | None = None
    guard_band: float = 1.0
    gimbal: GimbalReadings | None = None
    radial_sigma: float | None = None
    budget: tuple[TypeBTerm, ...] = ()
    passport_source: str = ""
    focus: TargetFocus | None = None
    compares_lenses: bool = False

    def __post_init__(self) -> None:
        if self.distortion in ("auto", ("auto",), ["auto"]):
            object.__setattr__(self, "distortion", "k1k2")
            object.__setattr__(self, "compares_lenses", True)
        require_known("model", self.model, get_args(ModelName))
        if self.loss is not None:
            require_known("loss", self.loss, get_args(LossName))
        if not isinstance(self.distortion, str | Sequence):
            raise InputMismatch(
                f"The distortion is {self.distortion!r}.", remedy='Name the lens, such as "k1k2".'
            )
        object.__setattr__(self, "distortion", distortion_names(self.distortion))
        if not isinstance(self.passport, Passport | None):
            raise InputMismatch(
                f"The passport is a {type(self.passport).__name__}.",
                remedy="Make it: calib.Passport.of_radius(r_mm, sigma_mm), or read a file of it.",
            )
        if not 0 < self.guard_band <= 1:
            raise InputMismatch(
                f"guard_band is {self.guard_band}; it must be above 0 and at most 1 (share of the disc's radius)."
            )
        for name in ("huber_px", "radial_sigma"):
            number = getattr(self, name)
            if number is not None and not 0 < number < np.inf:
                raise InputMismatch(f"{name} is {number}; it must be positive.")

    @property
    def unused(self) -> str:
        """A sentence that names the options that are given and that the model does not use; empty if there are none."""
        reference = self.model in REFERENCE_MODELS
        ignored = _ONLY_JOINT if reference else _ONLY_REFERENCE
        given = [what for name, what in ignored.items() if getattr(self, name) != getattr(type(self), name)]
        model = self.model if reference else "joint"
        return f"The {model} model does not use: {', '.join(given)}." if given else ""


def rms_and_mean(lengths: Array) -> tuple[float, float]:
    """Return the root mean square and the mean of the (N,) lengths of residual vectors, px."""
    return float(np.sqrt(np.mean(lengths**2))), float(lengths.mean())


@dataclass(frozen=True)
class ViewSummary:
    """Residuals of one view."""

    name: str  # The view's name
    n: int
    rms_px: float  # Root mean square of the lengths of its residual vectors, px
    mean_px: float  # Mean of the lengths of its residual vectors, px


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(ReadOnlyArrays):
    """A calibrated camera and everything that was estimated with it.

    Attributes
    ----------
    model
        Name of the fitted model.
    camera
        Intrinsics and distortion.
    collimator
        The shared centre; None for the planar model, which has none.
    rotations
        (n, 3, 3) float64 rotation of each view, camera <- target.
    centres
        (n, 3) float64 camera centre of each view in the target frame, mm.
    parameter_names, estimates
        Names and (G,) float64 values of the parameters that all views share; `values` has them by name.
    covariance
        (G, G) float64 joint covariance of the estimates, in their order.
    residuals_px
        For each view (N, 2) float64: image point found minus image point predicted, px.
    weights
        For each view (N,) float64: weight of each star in the robust loss, 0 to 1; 0 in the guard band.
    rms_px, mean_px
        Root mean square and mean of the lengths of all residual vectors, px. They show how well the model follows the
        data, not how accurate it is.
    variance_factor
        Estimated variance of the weighted residuals: 1 if the stars' covariances are right.
    degrees_of_freedom
        Number of measurements minus number of parameters; in the joint adjustment, minus the parameters that the stars
        determine, each as far as they do.
    views
        Summary of each view.
    converged, iterations
        Whether the adjustment reached its optimum, and its number of steps.
    birge_ratio
        How many times more than star noise explains the views differ (Birge, 1932); 1 is agreement.
    coverage_factor
        The k for which value +- k sigma covers 95.45 %: 2, or more if few views determine the sigmas.
    left_out_rms_px
        Root mean square residual of left-out views, of which only the rotation was adjusted, px; None if it was not
        measured.
    rotation_covariance
        (3 n, 3 n) float64 joint covariance of the rotation vectors on the camera's side, rad^2.
    budget
        1-sigma of each parameter by source; the squares of all sources add up to the square of `sigma`.
    notes
        Notes for the reader, in words.
    gimbal
        What was found out about the gimbal; None if its readings took no part.
    poses
        The pose of each view, as an index; views of one pose count as one in all uncertainties.
    budget_rows
        The uncertainty budget: a row for each source.
    not_included
        What nobody stated, with what it could do, in words.
    witnesses
        For each statement: what it says against what all others say. Of the joint adjustment; else empty.
    amplitudes
        The sizes of the errors that the joint adjustment estimated; else empty.
    remarks
        Those of the notes that explain a choice; every other note doubts the values.
    coverage_factors
        The k of each parameter by name, and that of the worst point of the sensor (``worst_corner``), if they differ;
        `coverage_factor` is that of fx. `k` has one for every parameter.
    glass
        What the joint adjustment found out about the collimator, for `passport`; None from another engine.
    boresight
        How the camera is turned against the stage's flange; None if no readings determined it.
    causes
        What a person did to the bench, as far as the views show it, the most probable first.
    rotation_errors
        How the errors of the rotations follow from those of camera and collimator; None from another engine.
    """

    model: str
    camera: CameraModel
    collimator: Collimator | None
    rotations: Array
    centres: Array
    parameter_names: tuple[str, ...]
    estimates: Array
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
    gimbal: GimbalEstimate | None = None
    poses: tuple[int, ...] = ()
    budget_rows: tuple[BudgetRow, ...] = ()
    not_included: tuple[str, ...] = ()
    witnesses: tuple[Witness, ...] = ()
    amplitudes: tuple[Amplitude, ...] = ()
    coverage_factors: Mapping[str, float] = field(default_factory=dict)
    glass: Passport | None = None
    remarks: tuple[str, ...] = ()
    boresight: Boresight | None = None
    rotation_errors: RotationErrors | None = None
    causes: tuple[Cause, ...] = ()

    @property
    def engine(self) -> dict[str, str | int]:
        """Name and version of the engine that makes results of this model."""
        name = "joint" if self.model == "joint" else "reference"
        return {"name": name, "version": ENGINES[name]}

    @property
    def values(self) -> Mapping[str, float]:
        """Value of each parameter, by name."""
        return dict(zip(self.parameter_names, self.estimates.tolist(), strict=True))

    @property
    def sigma(self) -> Mapping[str, float]:
        """Standard uncertainty (1 sigma) of each parameter, by name."""
        sigmas = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.parameter_names, sigmas.tolist(), strict=True))

    @property
    def k(self) -> Mapping[str, float]:
        """Coverage factor of each parameter, by name: value +- k sigma covers 95.45 %."""
        return {n: self.coverage_factors.get(n, self.coverage_factor) for n in self.parameter_names}

    @property
    def U(self) -> Mapping[str, float]:  # noqa: N802 - the symbol of JCGM 100:2008, 6.2.1
        """Expanded uncertainty of each parameter, by name: its own k times its sigma."""
        k = self.k
        return {name: k[name] * sigma for name, sigma in self.sigma.items()}

    def _table(self) -> tuple[str, list[ParameterRow], tuple[str, ...]]:
        """Return what a summary shows: a headline, the parameters, the camera's and the radius first, and the notes."""
        values, sigma, k = self.values, self.sigma, self.k
        first = [*self.camera.parameter_names, "r"]
        names = sorted(self.parameter_names, key=lambda name: name not in first)
        points = sum(view.n for view in self.views)
        ended = "converged" if self.converged else "did not converge"
        head = f"Calibration ({self.model}): {len(self.views)} views, {points} points, rms {self.rms_px:.4f} px, "
        rows = [ParameterRow(name, values[name], sigma[name], k[name]) for name in names]
        return f"{head}{ended} in {self.iterations} steps", rows, self.notes

    def __repr__(self) -> str:
        return as_text(*self._table())

    def _repr_html_(self) -> str:
        return as_html(*self._table())

    def frame(self) -> Any:
        """Return the parameters as a table of pandas.

        Returns
        -------
        pandas.DataFrame
            A row for each parameter, with ``value``, ``sigma``, ``k``, ``U`` and ``unit``.

        Raises
        ------
        InputMismatch
            If pandas is not installed.
        """
        return as_frame(self._table()[1])

    @property
    def camera_covariance(self) -> Array:
        """(K, K) float64 covariance of the camera's parameters, in the order of `CameraModel.parameter_names`."""
        at = [self.parameter_names.index(name) for name in self.camera.parameter_names]
        return np.asarray(self.covariance[np.ix_(at, at)])

    @property
    def correlation(self) -> Array:
        """(G, G) float64 correlation matrix of the parameters."""
        sigmas = np.sqrt(np.diag(self.covariance))
        return np.asarray(self.covariance / np.outer(sigmas, sigmas))

    def passport(self, conditions: Mapping[str, Any] | None = None) -> Passport:
        """Return the passport of the collimator, to calibrate other cameras.

        Parameters
        ----------
        conditions
            Further facts to store: serial number, temperature, date.

        Returns
        -------
        Passport
            The collimator's parameters with their covariance.

        Raises
        ------
        InputMismatch
            If the model is planar, which has no collimator.
        """
        if self.collimator is None:
            raise InputMismatch(
                "The planar model has no collimator parameters.", remedy="Calibrate with another model."
            )
        if self.glass is not None:
            return replace(self.glass, conditions={**self.glass.conditions, **(conditions or {})})
        names, reference = self.collimator.parameter_names, self.collimator.reference
        at = [self.parameter_names.index(name) for name in names]
        values, covariance = self.estimates[at], self.covariance[np.ix_(at, at)]
        views = tuple(view.name for view in self.views)
        return Passport(names, values, covariance, reference, self.birge_ratio, views, conditions or {})

    def to_dict(self) -> dict[str, Any]:
        """Return the result as plain numbers, lists and names, ready for JSON.

        Returns
        -------
        dict of str to Any
            All results except residuals and weights; ``disagreement`` is the Birge ratio.
        """
        poses = zip(self.views, self.rotations.tolist(), self.centres.tolist(), strict=True)
        return {
            "model": self.model,
            "engine": dict(self.engine),
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
                {**asdict(view), "rotation": rotation, "centre_mm": centre}
                for view, rotation, centre in poses
            ],
            "notes": list(self.notes),
            "remarks": list(self.remarks),
            **({"gimbal": asdict(self.gimbal)} if self.gimbal else {}),
            **({"boresight": self.boresight.to_dict()} if self.boresight else {}),
            "budget_rows": [asdict(row) for row in self.budget_rows],
            "not_included": list(self.not_included),
            "witnesses": [asdict(witness) for witness in self.witnesses],
            "amplitudes": [asdict(amplitude) for amplitude in self.amplitudes],
            "coverage_factors": dict(self.coverage_factors),
        }
