"""The solve step as a pydantic model; its names are the engine's, and a test of the bench compares them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, field_validator

from sequences.strict_model import StrictModel, Within

CalibrationModel = Literal["auto", "joint", "spherical", "planar"]
DistortionTerm = Literal["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "skew", "kb1", "kb2", "kb3", "kb4"]
DistortionSet = Literal[
    "none", "k1", "k1k2", "k1k2k3", "k1k2p1p2", "k1k2k3p1p2", "rational", "fisheye", "auto"
]
Readings = Literal["auto", "witness"]
Loss = Literal["huber", "l2", "cauchy"]

Limit = Annotated[float, Field(gt=0)] | None
LENS_FAMILIES: tuple[tuple[str, ...], ...] = (
    ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "skew"),
    ("kb1", "kb2", "kb3", "kb4"),
)
"""Coefficients of each lens model, with the skew of the camera matrix; those of two models cannot be estimated
together."""
DISTORTION_SETS: Mapping[str, tuple[str, ...]] = {
    "none": (),
    "k1": ("k1",),
    "k1k2": ("k1", "k2"),
    "k1k2k3": ("k1", "k2", "k3"),
    "k1k2p1p2": ("k1", "k2", "p1", "p2"),
    "k1k2k3p1p2": ("k1", "k2", "p1", "p2", "k3"),
    "rational": LENS_FAMILIES[0][:8],
    "fisheye": LENS_FAMILIES[1],
}
"""Coefficients by the name of their set."""


class LimitConfig(StrictModel):
    """Upper limits of the result. Above a limit the result fails; within a tenth below it, it is marginal."""

    rms_px: Limit = None
    mean_px: Limit = None
    sigma_fx_px: Limit = None
    sigma_fy_px: Limit = None
    sigma_cx_px: Limit = None
    sigma_cy_px: Limit = None
    sigma_k1: Limit = None
    sigma_k2: Limit = None
    sigma_p1: Limit = None
    sigma_p2: Limit = None
    sigma_k3: Limit = None
    sigma_k4: Limit = None
    sigma_k5: Limit = None
    sigma_k6: Limit = None
    sigma_skew_px: Limit = None
    sigma_kb1: Limit = None
    sigma_kb2: Limit = None
    sigma_kb3: Limit = None
    sigma_kb4: Limit = None
    sigma_x_mm: Limit = None
    sigma_y_mm: Limit = None
    sigma_r_mm: Limit = None
    expanded_fx_px: Limit = None
    expanded_fy_px: Limit = None
    worst_corner_px: Limit = None


def _set_or_list(value: Any) -> str:
    return "set" if isinstance(value, str) else "list"


class SolveConfig(StrictModel):
    """Calibrate from the poses recorded so far."""

    model: CalibrationModel | None = None
    """Default: joint, also written auto."""
    distortion: Annotated[
        Annotated[DistortionSet, Tag("set")] | Annotated[tuple[DistortionTerm, ...], Tag("list")],
        Discriminator(_set_or_list),
    ] = ("k1", "k2")
    loss: Loss | None = None
    """Default: huber."""
    huber_px: Annotated[float, Within(0.001, 100, "px")] | None = None
    passport: Annotated[str | None, Field(min_length=1, max_length=4096)] = None
    """Passport file of the collimator, instead of the station's; none: use no passport."""
    other_collimator: Literal["refuse", "accept"] = "refuse"
    """Passport of another collimator than the station's."""
    readings: Readings = "auto"
    """witness: the gimbal's readings never enter the adjustment."""
    guard_band: Annotated[float, Within(0.05, 1)] = 1.0
    """Share of the beam's radius to use."""
    drift_mm: Annotated[float, Within(1e-6, 1000, "mm")] = 0.3
    """Of sequences of earlier versions; it has no effect."""
    limits: LimitConfig = LimitConfig()

    @field_validator("distortion")
    @classmethod
    def _one_lens_each_term_once(cls, terms: str | tuple[str, ...]) -> str | tuple[str, ...]:
        if isinstance(terms, str):
            return terms
        if len(set(terms)) != len(terms):
            raise ValueError("a distortion term is given twice.")
        if not any(set(terms) <= set(family) for family in LENS_FAMILIES):
            known = " or ".join(" ".join(family) for family in LENS_FAMILIES)
            raise ValueError(f"no lens model has all these terms; use terms of {known}.")
        return terms


class CheckConfig(SolveConfig):
    """Calibrate from the poses so far, as a solve does, and check a stated calibration by the result."""

    calibration: Annotated[str, Field(min_length=1, max_length=4096)]
    """The calibration to check: a run folder, results.json, or a file of OpenCV, ROS, Kalibr or Metavision."""
