"""Faults of a motion, and the events that a controller notices because of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

FaultKind = Literal[
    "stall", "limit", "twist", "restart", "stop_short", "no_progress", "slip", "creep", "unplug", "press_stop"
]

Noticed = Literal["stall", "limit", "twist", "restart"]


@dataclass(frozen=True)
class MotionFault:
    """A fault of a motion to come.

    Attributes
    ----------
    kind
        ``stall``: the motor is blocked. ``limit``: a limit switch closes. ``twist``: the two axes of a lockstep
        pair lose their alignment. ``restart``: the controller reboots. ``stop_short``: it stops as if it had
        arrived. ``no_progress``: it stops and keeps reporting busy. ``slip``: the motor stands still, the counter
        continues. ``creep``: the motor drifts after it has arrived, and the counter does not follow. ``unplug``,
        ``press_stop``: an event outside the controller, which ``then`` causes.
    share
        Time of the fault, as a share of the motion's duration; ``creep`` begins at the end whatever the share.
    creep_deg_s
        Speed of the drift, degrees/s.
    skip
        Number of motions that pass unchanged first.
    then
        Called when the motion begins, with the time at which the fault happens, s.
    """

    kind: FaultKind
    share: float = 0.5
    creep_deg_s: float = 0.01
    skip: int = 0
    then: Callable[[float], None] | None = None


class MotionEvent(NamedTuple):
    """An event that the controller notices.

    Attributes
    ----------
    kind
        What happened.
    t_s
        Time of the event, s.
    """

    kind: Noticed
    t_s: float
