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
    """A fault of a motion to come."""

    # ``stall``: the motor is blocked. ``limit``: a limit switch closes. ``twist``: the two axes of a lockstep
    # pair lose their alignment. ``restart``: the controller reboots. ``stop_short``: it stops as if it had
    # arrived. ``no_progress``: it stops and keeps reporting busy. ``slip``: the motor stands still, the
    # counter continues. ``creep``: the motor drifts after it has arrived, and the counter does not follow.
    # ``unplug``, ``press_stop``: an event outside the controller, which ``then`` causes.
    kind: FaultKind
    # Time of the fault, as a share of the motion's duration; ``creep`` begins at the end whatever the share.
    share: float = 0.5
    creep_deg_s: float = 0.01  # Speed of the drift, degrees/s
    skip: int = 0  # Number of motions that pass unchanged first
    # Called when the motion begins, with the time at which the fault happens, s.
    then: Callable[[float], None] | None = None


class MotionEvent(NamedTuple):
    """An event that the controller notices."""

    kind: Noticed
    t_s: float  # Time of the event, s
