"""The interface of a stage: one to three rotary axes, in degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True)
class AxisIdentity:
    """Identity of an axis, as its controller reports it.

    Attributes
    ----------
    name
        Name of the axis in the station file.
    maker, model
        Maker and model of the controller or of the stage.
    serial
        Serial number; empty when the controller has none.
    firmware
        Version of the controller's firmware.
    """

    name: str
    maker: str
    model: str
    serial: str
    firmware: str


@dataclass(frozen=True)
class AxisLimits:
    """Limits of an axis in the station file. Targets are checked before anything is sent.

    Attributes
    ----------
    lowest_deg, highest_deg
        Soft limits, in degrees.
    speed_deg_s
        Speed of moves, in degrees per second.
    acceleration_deg_s2
        Acceleration of moves, in degrees per second squared.
    """

    lowest_deg: float
    highest_deg: float
    speed_deg_s: float
    acceleration_deg_s2: float


class Stage(Protocol):
    """A stage. Only ``home`` and ``move_to`` move it.

    Every wait goes through the clock given at opening, so the clock can interrupt it; the caller then calls ``stop``.
    All methods raise ``drivers.errors.DriverError`` and nothing else, exceptions of the clock excepted.
    """

    @property
    def axes(self) -> Sequence[str]:
        """Names of the axes ("pan", "tilt", "roll"), in the order of the station file."""

    @property
    def limits(self) -> Mapping[str, AxisLimits]:
        """Soft limits, by axis."""

    def identify(self) -> Sequence[AxisIdentity]:
        """Ask every axis for its identity.

        Returns
        -------
        sequence of AxisIdentity
            One entry an axis.

        Raises
        ------
        WrongDevice
            A serial number is not the one in the station file.
        """

    def is_homed(self) -> bool:
        """Ask whether every axis has a reference.

        Returns
        -------
        bool
            False also when a move has ended at an unknown position since the last homing.
        """

    def home(self) -> None:
        """Search the reference of every axis, and wait for the end of it.

        Raises
        ------
        WrongDevice
            A serial number is not the one in the station file; nothing was moved.
        MoveFailed, MoveTimeout
            The search failed, or had not ended by its deadline; all axes were stopped.
        """

    def move_to(self, target_deg: Mapping[str, float]) -> None:
        """Move axes to absolute angles, and wait until they have arrived.

        The limits of all axes are checked before anything is sent. An axis has arrived after two idle readings with
        the position at the target. The deadline follows from distance, speed and acceleration.

        Parameters
        ----------
        target_deg
            Target of each axis that is to move, in degrees.

        Raises
        ------
        OutsideLimits, NotHomed
            The move is not possible; nothing was sent.
        MoveFailed, MoveTimeout
            An axis did not arrive; all axes were stopped.
        """

    def move_duration_s(self, from_deg: Mapping[str, float], to_deg: Mapping[str, float]) -> float:
        """Return the expected time of a move, from the speeds and accelerations of the axes.

        Parameters
        ----------
        from_deg, to_deg
            Start and target of each axis that moves, in degrees.

        Returns
        -------
        float
            Time, in seconds.
        """

    def position_deg(self) -> Mapping[str, float]:
        """Read the position counters.

        Returns
        -------
        mapping
            Position by axis, in degrees.
        """

    def encoder_deg(self) -> Mapping[str, float]:
        """Read the encoders.

        Returns
        -------
        mapping
            Encoder reading by axis, in degrees; only of axes that have an encoder.
        """

    def faults(self) -> Sequence[str]:
        """Ask for present faults and warnings.

        Returns
        -------
        sequence of str
            One sentence a fault; empty without faults.
        """

    def stop(self) -> None:
        """Stop all axes at once. Any thread may call this, also while another one waits in a move."""

    def close(self) -> None:
        """Close the port. The stage stays where it is."""
