"""Decide what a controller's state means for a move, for stages whose axes have a controller and a line each.

``drivers.stage.watched`` watches the moves. This module implements no protocol.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any, ClassVar, Generic, Protocol, Self, TypeVar

from drivers.clock import Clock
from drivers.link import Link
from drivers.serial_port import LineSettings, Port, SerialPort, closed_on_error
from drivers.stage import motion
from drivers.stage.motion import A
from drivers.stage.refusals import CLEAR_AND_HOME, no_reference, not_movable
from drivers.stage.watched import AxisState, WatchedStage
from drivers.wire_log import WireLog


class ControllerStatus(Protocol):
    """State of an axis, as its own controller reports it."""

    @property
    def homed(self) -> bool:
        """Whether the axis has a reference."""

    @property
    def faults(self) -> list[str]:
        """Faults that keep the axis from moving."""


class AxisController(Link):
    """The line of a controller that drives one axis and reports whether that has a reference."""

    @abstractmethod
    def read_status(self) -> ControllerStatus:
        """Ask for the state of the axis."""


C = TypeVar("C", bound=AxisController)


class LinePerAxisStage(WatchedStage[A], Generic[A, C]):
    """A stage each of whose axes has a controller on a line of its own. Its axes have a ``port``.

    Open it with ``open``; the constructor takes the open port of each axis's controller. Axes stand in the order of
    the station file.
    """

    _lines: Mapping[str, C]
    SETTINGS: ClassVar[LineSettings]
    """Settings of the ports."""
    CONTROLLER: ClassVar[Callable[..., Any]]
    """Makes the line of a controller on an open port."""
    FAULT_REMEDY: ClassVar = CLEAR_AND_HOME
    """What to do about a fault."""

    def __init__(
        self, ports: Sequence[Port], axes: Sequence[A], *, clock: Clock, wire_log: WireLog | None = None
    ) -> None:
        super().__init__(axes, clock=clock, where=", ".join(port.name for port in ports))
        with closed_on_error(*ports):
            self._lines = {
                axis.name: self.CONTROLLER(port, clock=clock, wire_log=wire_log)
                for axis, port in zip(axes, ports, strict=True)
            }
            self.identify()
            self._set_up()
            self._bring_to_rest()
            for axis in self._axes.values():
                self._program(axis)

    @abstractmethod
    def _set_up(self) -> None:
        """Compare the station file with what the controllers tell, before anything is sent that they act on."""

    @abstractmethod
    def _program(self, axis: A) -> None:
        """Set all that another program may have left otherwise, or a restart has undone; read it back."""

    @classmethod
    def open(cls, axes: Sequence[A], *, clock: Clock, wire_log: WireLog | None = None) -> Self:
        """Open all ports, check the serial numbers, and set speeds and limits. Moves nothing.

        The ports raise the errors of ``drivers.serial_port.SerialPort``.
        """
        ports: list[Port] = []
        with ExitStack() as opened:
            for axis in axes:
                address: Any = axis
                ports.append(SerialPort(address.port, cls.SETTINGS))
                opened.callback(ports[-1].close)
            opened.pop_all()
        return cls(ports, axes, clock=clock, wire_log=wire_log)

    def _has_reference(self) -> bool:
        return self._was_homed() and all(line.read_status().homed for line in self._lines.values())

    def _faults_of(self, axis: A) -> list[str]:
        status = self._lines[axis.name].read_status()
        return status.faults + ([] if status.homed else ["no reference"])

    def _check_ready(self, axis: A) -> None:
        status = self._lines[axis.name].read_status()
        if not status.homed:
            raise no_reference(axis)
        if not self._was_homed():
            raise no_reference(axis, motion.HOMED_BY_ANOTHER)
        self._raise_faults(axis, status)

    def _raise_faults(self, axis: A, status: ControllerStatus) -> None:
        if status.faults:
            raise not_movable(axis, ", ".join(status.faults), self.FAULT_REMEDY)

    def _problem(self, status: ControllerStatus, *, homing: bool) -> str:
        """Return why a move in this state will not end at its target; empty when it may."""
        if status.faults:
            return ", ".join(status.faults)
        if not status.homed and not homing:
            return "the controller lost its reference during the move, as after a restart"
        return ""

    def _read_final_state(self, axis: A, *, homing: bool) -> AxisState:
        state = self._read_state(axis, homing=homing)
        if homing and not self._lines[axis.name].read_status().homed:
            return state._replace(problem="homing ended without a reference")
        return state

    @abstractmethod
    def _stop_one(self, name: str) -> None:
        """Stop one axis, and check that its controller received the stop."""

    def _send_stop(self) -> None:
        """Stop all axes at the same time: no axis waits for the reply of another controller."""
        with ThreadPoolExecutor(len(self._lines)) as pool:
            stops = [pool.submit(self._stop_one, name) for name in self._lines]
        for stop in stops:
            stop.result()
