"""The fixed texts of a certificate. Texts only."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.certificate.certificate_data import Statement
from bench.certificate.lab_config import NONE, LabConfig
from bench.certificate.run_facts import is_unnamed
from bench.records.results import Results
from calib.model.lens import is_fisheye

_SIMULATED = (
    "SIMULATED: the devices of this calibration were simulated. This document shows the procedure; it is no calibration"
    " of a real camera."
)
_ITEMS = "The results relate only to the item calibrated, in the condition and with the settings described."
_READ_FROM_THE_ITEM = (
    "The camera does not report maker, model and serial number; the laboratory read them from the item."
)
_REPRODUCTION = (
    "This certificate shall not be reproduced except in full, unless the laboratory approves in writing."
)
_UNCERTAINTY = (
    "The expanded uncertainty U is the standard uncertainty u multiplied by the coverage factor k that is stated with"
    " each result: U = k u. For a t-distribution with the stated effective degrees of freedom it corresponds to a"
    " coverage probability of about 95 %. The standard uncertainties were determined by JCGM 100 (GUM); the joint"
    " covariance is stated. For quantities that are calculated from several results, use the largest k. U has two"
    " significant digits and is rounded up, unless rounding down changes it by 1 % or less."
)
_ADJUSTMENT = "The item was calibrated as received. Nothing was adjusted or repaired."
_NOT_ACCREDITED = "This calibration is not covered by an accreditation."
_CUSTOMER_DATA = (
    "Data that the customer supplied are marked. They can affect the validity of results; the laboratory is not"
    " responsible for them."
)
_AUTHORISATION = (
    "This document is sealed by the calibration bench. It is authorised only with the signature of the person named,"
    " which lies beside the seal: SHA256SUMS.authorised.sig. Without it this document is not a valid certificate."
)
_BROWN = (
    "A point (X, Y, Z) in the frame of the camera has x = X / Z, y = Y / Z and r2 = x x + y y. With the radial factor"
    " L = (1 + k1 r2 + k2 r2^2 + k3 r2^3) / (1 + k4 r2 + k5 r2^2 + k6 r2^3) its image point is"
    " u = fx (L x + 2 p1 x y + p2 (r2 + 2 x x)) + cx and v = fy (L y + p1 (r2 + 2 y y) + 2 p2 x y) + cy, in pixels;"
    " the centre of the first pixel is (0, 0). Coefficients that are not listed are zero (Brown's model as in OpenCV)."
)
_SKEW = " To u, the skew times the factor of fy in v is added: K[0, 1] of the camera matrix, in pixels."
_FISHEYE = (
    "A point (X, Y, Z) in the frame of the camera has x = X / Z, y = Y / Z, r = sqrt(x x + y y) and the angle"
    " t = atan(r). With d = t (1 + kb1 t^2 + kb2 t^4 + kb3 t^6 + kb4 t^8) / r its image point is u = fx d x + cx and"
    " v = fy d y + cy, in pixels; the centre of the first pixel is (0, 0). Coefficients that are not listed are zero"
    " (model of Kannala and Brandt, OpenCV's fisheye model)."
)


def statements_of(found: Results, lab: LabConfig, *, also: str, verified: str) -> tuple[Statement, ...]:
    """Return the fixed texts of a certificate, in the order in which they are printed.

    also: Why a second certificate is issued for the run; empty if it is the first one.
    verified: What was verified before the issue; empty if nothing is stated.
    """
    calibration = found["calibration"]
    notes = " ".join(str(note) for note in calibration.get("notes") or [])
    left_out = "; ".join(str(line) for line in calibration.get("not_included") or [])
    pairs = [
        ("simulated", _SIMULATED if found["run"]["simulated"] else ""),
        ("authorisation", _AUTHORISATION),
        ("accreditation", _NOT_ACCREDITED if lab.laboratory.accreditation == NONE else ""),
        ("items", _ITEMS),
        ("identity", _READ_FROM_THE_ITEM if is_unnamed(found) else ""),
        ("reproduction", _REPRODUCTION),
        ("model", _model_of(calibration["camera"])),
        ("uncertainty", _UNCERTAINTY),
        ("notes", notes),
        ("not_included", f"Not known and not included in the uncertainty: {left_out}." if left_out else ""),
        ("traceability", lab.traceability or ""),
        ("verification", verified),
        ("adjustment", _ADJUSTMENT),
        ("customer_data", _CUSTOMER_DATA if lab.customer_supplied else ""),
        ("recalibration", f"Recalibration: {lab.recalibration}" if lab.recalibration else ""),
        ("also", f"This is a further certificate of the same run. Reason: {also}" if also else ""),
    ]
    return tuple(Statement(name, text) for name, text in pairs if text)


def _model_of(camera: Mapping[str, Any]) -> str:
    """Return the equations of a camera's model in words."""
    if is_fisheye(camera):
        return _FISHEYE
    return _BROWN + _SKEW if "skew" in camera else _BROWN
