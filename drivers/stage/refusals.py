"""Build the errors of an axis that may not be moved, and of settings that read otherwise than they were written."""

from __future__ import annotations

from drivers.errors import DeviceRefused, MoveFailed, NotHomed, OutsideLimits
from drivers.stage.motion import Axis

HOME_FIRST = "Home the stage first."
CLEAR_AND_HOME = "Clear the cause, then home the stage."
CHECK_PORTS = "Check the ports and serials in the station file."
TO_WHAT_IT_SUPPORTS = "Change the station file to what the controller supports."


def no_reference(axis: Axis, what: str = "the axis has no reference") -> NotHomed:
    """Build the error of an axis without a reference."""
    return NotHomed(f"{what}. Nothing was moved.", where=axis.name, remedy=HOME_FIRST)


def not_movable(axis: Axis, why: str, remedy: str = CLEAR_AND_HOME) -> MoveFailed:
    """Build the error of an axis that may not be moved."""
    return MoveFailed(f"{why}. Nothing was moved.", where=axis.name, remedy=remedy)


def reads_otherwise(
    axis: Axis, what: str, wanted: object, got: object, remedy: str = TO_WHAT_IT_SUPPORTS
) -> DeviceRefused:
    """Build the error of a setting that was written and reads otherwise."""
    return DeviceRefused(f"{what} was set to {wanted}, but reads {got}.", where=axis.name, remedy=remedy)


def read_back_otherwise(where: str, what: str, wanted: object, got: object) -> DeviceRefused:
    """Build the error of a group of settings that was written and reads otherwise."""
    return DeviceRefused(
        f"{what} read back differently from what was set: {got} instead of {wanted}.",
        where=where,
        remedy=TO_WHAT_IT_SUPPORTS,
    )


def not_as_stated(where: str, name: str, stated: float, present: float | None, send: str) -> OutsideLimits:
    """Build the error of a setting that changes every angle, and is not the one that the station file states."""
    if present is None:
        has, remedy = "no such setting", f"Take {name} out of `settings` in the station file."
    else:
        has = f"{present:g}"
        remedy = f"Send '{send}', or write {name}: {has} under `settings` in the station file and find zero_deg anew."
    return OutsideLimits(
        f"the station has {name} {stated:g}, the controller has {has}. Nothing was set.",
        where=where,
        remedy=remedy,
    )
