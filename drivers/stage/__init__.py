"""What the bench expects of a stage: one to three rotary axes, in degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class AxisIdentity:
    """Who turns an axis, as its controller says."""

    name: str
    maker: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True)
class AxisLimits:
    """Soft limits of an axis, checked before anything is sent."""

    lowest_deg: float
    highest_deg: float
    speed_deg_s: float
    acceleration_deg_s2: float


class Stage(Protocol):
    """A stage. Nothing moves but by ``home``, ``move_to`` and ``park``.

    Every waiting call goes through the clock given at opening, so an interrupting clock ends it; the
    caller then calls ``stop``. All methods raise ``drivers.errors.DriverError`` and nothing else.
    """

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes, in the station file's order (of "pan", "tilt", "roll")."""
        ...

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        """Soft limits, by axis."""
        ...

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis who it is. Raises WrongDevice when a serial number differs from the given one."""
        ...

    def is_homed(self) -> bool:
        """Whether every axis has a reference."""
        ...

    def home(self) -> None:
        """Find the reference of every axis; blocks; raises WrongDevice, MoveFailed or MoveTimeout."""
        ...

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """Move the named axes to absolute angles and see that they arrive.

        Blocks. Checks limits of all axes before sending anything. Done only after two idle reads and the
        position at target; bounded by a deadline from distance, speed and acceleration.
        """
        ...

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Expected time of a move, from the axes' speeds and accelerations."""
        ...

    def position_deg(self) -> Mapping[str, float]:
        """Position counter, by axis."""
        ...

    def encoder_deg(self) -> Mapping[str, float]:
        """Encoder reading of those axes that have one; may be empty."""
        ...

    def faults(self) -> Sequence[str]:
        """Present faults and warnings in plain words; empty when all is well."""
        ...

    def stop(self) -> None:
        """Stop all axes at once. Its own short path: callable from any thread, while a move waits."""
        ...

    def close(self) -> None:
        """Give the port back; the stage stays where it is."""
        ...
