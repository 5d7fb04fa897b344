"""Every error the engine raises; each says what is wrong, where, and what to do.

CalibrationError
├── TargetNotFound      no tag, or an ambiguous one, in an event image
│   └── StarsUnnamed    stars are there, but nothing tells which they are
├── TooFewStars         a view with too few stars to constrain anything
├── TooFewEvents        a slice too empty, or without whole flicker periods, to make an image of
├── FlickerNotFound     no usable triggers and no periodicity in the stream
├── DegenerateViews     views that do not constrain the camera: too few, same pose twice, parallel axes
├── PassportContradicted  views that contradict what is known of the collimator
├── NotConverged        refinement ended without reaching an optimum
└── InputMismatch       shapes, sizes, ids or options that contradict each other
"""

from __future__ import annotations


class CalibrationError(Exception):
    """What is wrong, where, and what to do about it."""

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        self.what = what
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{what}{advice}")


class TargetNotFound(CalibrationError):
    """No tag, or an ambiguous one, was found."""


class StarsUnnamed(TargetNotFound):
    """Stars were found, but nothing tells which they are."""


class TooFewStars(CalibrationError):
    """Too few stars were found."""


class TooFewEvents(CalibrationError):
    """The slice is too empty, or too short, to make an image of."""


class FlickerNotFound(CalibrationError):
    """Neither triggers nor the stream tell the flicker's phase."""


class DegenerateViews(CalibrationError):
    """These views do not constrain the camera."""


class PassportContradicted(CalibrationError):
    """The views contradict what is known of the collimator."""


class NotConverged(CalibrationError):
    """The refinement did not reach an optimum."""


class InputMismatch(CalibrationError):
    """Inputs that contradict each other."""
