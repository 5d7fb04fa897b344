"""The one place where what a station states becomes options of the engine, and a result becomes numbers.

If the engine's options change, only this module does.
"""

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import calib
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.target_focus import TargetFocus
from calib.model.type_b_terms import TypeBTerm

from .bench import Bench, Stated

Array = NDArray[np.float64]

#: cr: certificate and bounded readings; c: certificate; r: bounded readings; 0: nothing.
KNOWN = ("cr", "c", "r", "0")
SOURCE = "drawn"
_LENGTHS = {"radius": "seen", "focal length": "focal_length"}
#: The engine that is judged: ``auto`` or ``joint``.
MODEL: Any = os.environ.get("STARBENCH_JUDGED_MODEL", "auto")


@dataclass(frozen=True)
class Answer:
    """What the engine states about a camera."""

    values: dict[str, float]  # fx, fy, cx, cy and the lens's coefficients
    covariance: Array  # of the values, in their order
    coverage_factor: float
    factors: dict[str, float]  # k of each value that has its own
    notes: tuple[str, ...]
    model: str
    rms_px: float
    left_out_rms_px: float | None
    raw: Any  # the engine's own result


def views_of(bench: Bench) -> list[calib.View]:
    """Return the views as the engine takes them."""
    return [
        calib.View(
            v.name,
            bench.facts.get("size_px", (1280, 720)),
            v.ids,
            v.px,
            v.mm,
            v.sigma_px[:, None, None] ** 2 * np.eye(2),
            recorded_s=v.recorded_s,
        )
        for v in bench.views
    ]


def options_for(
    bench: Bench, known: str, lens: str = "shipped", passport: calib.Passport | None = None
) -> calib.CalibrationOptions:
    """Return the options of a station that states so much.

    known: One of KNOWN, or ``passport`` with a passport of an earlier calibration.
    lens: ``shipped``: k1 and k2, as the shipped sequences ask for; ``right``: the terms that the lens has. A fisheye is
      always told.
    """
    stated = bench.stated
    if passport is None and "c" in known:
        length = _LENGTHS[stated.certifies] if stated.says_length else ""
        passport = calib.Passport.of_radius(stated.r_mm, stated.r_sigma_mm, length=length)
    return calib.CalibrationOptions(
        model=MODEL,
        distortion=_distortion(bench.camera.family, lens),
        passport=passport,
        passport_source="certificate" if known in ("cr", "c") else "passport" if passport else "",
        gimbal=_readings(bench) if "r" in known else None,
        budget=_budget(stated) if known != "0" else (),
        focus=_focus(stated) if "c" in known else None,
    )


def _distortion(family: str, lens: str) -> str:
    if family == "fisheye":
        return "fisheye"
    return "k1k2k3p1p2" if lens == "right" and family != "k1k2" else "k1k2"


def _focus(stated: Stated) -> TargetFocus | None:
    """Where the pupil is before the focal plane: stated by who knows that the certificate means the focal length."""
    if not stated.says_length or stated.pupil_to_focus_mm is None or stated.certifies == "radius":
        return None
    return TargetFocus(pupil_to_focus_mm=stated.pupil_to_focus_mm)


def _readings(bench: Bench) -> GimbalReadings:
    s = bench.stated
    bound = ParallaxBound(*s.defocus, *s.off_pivot_mm) if s.bounded else None
    return GimbalReadings(
        tuple(bench.readings_deg), s.reading_sigma_deg, s.scale_sigma, s.eccentricity_deg, bound, SOURCE
    )


def _budget(s: Stated) -> tuple[TypeBTerm, ...]:
    terms = [
        TypeBTerm("scale of the print", "print_scale", s.print_scale, SOURCE, "rectangular"),
        TypeBTerm("bow of the print", "print_bow", s.print_bow_mm, SOURCE, "rectangular", radius_mm=40.0),
        TypeBTerm("thermal expansion of the print", "thermal", s.thermal, SOURCE),
    ]
    if s.effective_radius is not None:
        terms.append(TypeBTerm("effective radius", "effective_radius", s.effective_radius, SOURCE))
    return tuple(terms)


def solve(bench: Bench, options: calib.CalibrationOptions) -> Answer:
    """Calibrate a bench.

    Raises CalibrationError: If the engine refuses.
    """
    calibration = calib.calibrate(views_of(bench), options)
    camera = calibration.camera
    names = camera.parameter_names
    values = dict(zip(names, camera.values.tolist(), strict=True))
    covariance = np.asarray(calibration.camera_covariance)
    return Answer(
        values,
        covariance,
        float(calibration.coverage_factor),
        dict(getattr(calibration, "coverage_factors", {})),  # an engine may have one k for all
        tuple(calibration.notes),
        calibration.model,
        float(calibration.rms_px),
        calibration.left_out_rms_px,
        calibration,
    )


def passport_of(answer: Answer) -> calib.Passport:
    """Return the passport of the collimator that a calibration leaves."""
    passport = answer.raw.passport()
    assert isinstance(passport, calib.Passport)
    return passport
