"""All errors that the engine raises. Each says what is wrong, where, and what to do.

CalibrationError
├── TargetNotFound        the image shows no target, or a wrong or ambiguous tag
│   └── StarsUnnamed      the image shows stars, but neither the tag nor a pose identifies them
├── TooFewStars           too few stars to fit or compare anything
├── TooFewEvents          too few events, or no whole flicker period, for an image
├── FlickerNotFound       neither the triggers nor the events show a period
├── DegenerateViews       views that do not determine the camera: too few, twice the same pose, parallel axes
├── NotConverged          an adjustment that did not reach its optimum
└── InputMismatch         shapes, sizes, ids or options that contradict each other
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any


class CalibrationError(Exception):
    """Base class of the engine's errors.

    Parameters
    ----------
    what
        What is wrong, a sentence.
    where
        The view, file or step concerned; may be empty.
    remedy
        What to do about it, a sentence; may be empty.
    """

    def __init__(self, what: str, *, where: str = "", remedy: str = "") -> None:
        # A sentence that ends with a quoted one has two full stops.
        self.what = what[:-1] if what.endswith("..") and not what.endswith("...") else what
        self.where = where
        self.remedy = remedy
        place = f"{where}: " if where else ""
        advice = f" {remedy}" if remedy else ""
        super().__init__(f"{place}{self.what}{advice}")


@contextmanager
def placed(where: str) -> Iterator[None]:
    """Let the errors that are raised inside, and that name no place, name this one."""
    try:
        yield
    except CalibrationError as error:
        if not error.where:
            error.where, error.args = where, (f"{where}: {error}",)
        raise


def require_known(what: str, given: object, known: Sequence[str], where: str = "") -> None:
    """Refuse (`InputMismatch`) a name that is none of the known ones, which are told."""
    if given not in known:
        raise InputMismatch(f"Unknown {what} {given!r}.", where=where, remedy=f"Known: {', '.join(known)}.")


def require_unmasked(given: Any, what: str, *, where: str = "", remedy: str) -> None:
    """Refuse (`InputMismatch`) an array of which a part is masked: NumPy would drop the mask and use all of it."""
    if hasattr(given, "filled") and given.mask.any():
        raise InputMismatch(f"{what} masked values, which would be used.", where=where, remedy=remedy)


class TargetNotFound(CalibrationError):
    """The image shows no target, or a wrong or ambiguous tag."""


class StarsUnnamed(TargetNotFound):
    """The image shows stars, but neither the tag nor an expected pose identifies them."""


class TooFewStars(CalibrationError):
    """There are too few stars to fit or compare anything."""


class TooFewEvents(CalibrationError):
    """There are too few events, or no whole flicker period, for an image."""


class FlickerNotFound(CalibrationError):
    """Neither the triggers nor the events show the period of the flicker."""


class DegenerateViews(CalibrationError):
    """The views do not determine the camera."""


class NotConverged(CalibrationError):
    """The adjustment did not reach its optimum."""


class InputMismatch(CalibrationError):
    """The inputs contradict each other."""
