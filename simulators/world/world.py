"""The simulated world: angles of the axes and state of the light at every moment.

Simulated stages and lights write into it, and the simulated camera reads from it; they do not use each other. The past
is kept, so that a camera that computes a recording a little late still gets the past state. This module uses no
protocol and no optics. Thread-safe.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from simulators.world import placing, temperature
from simulators.world.board_light import light_of_board
from simulators.world.camera_setup import CameraSetup, setup_of, with_setup
from simulators.world.history import History
from simulators.world.light_state import FULL_DRIVE_V as FULL_DRIVE_V  # noqa: PLC0414 - exported
from simulators.world.light_state import LightState as LightState  # noqa: PLC0414 - exported
from simulators.world.light_state import Waveform as Waveform  # noqa: PLC0414 - exported
from simulators.world.truth import Truth

AxisName = Literal["pan", "tilt", "roll"]


@dataclass(frozen=True)
class AxisMotion:
    """Motion of an axis from some moment on, until its next motion is set."""

    # Returns the angle in degrees at a world time in seconds. Must be pure: the same time gives the same
    # angle.
    angle_at: Callable[[float], float]
    # World time from which on the angle no longer changes; ``math.inf`` for a motion without end.
    settled_from_s: float
    microsteps: int  # Position after ``settled_from_s``, one of the numbers that seed a recording's noise

    @classmethod
    def resting(cls, angle_deg: float, microsteps: int) -> AxisMotion:
        """Return the motion of an axis that stands still.

        angle_deg: Where it stands.
        """
        return cls(angle_at=lambda _t_s: angle_deg, settled_from_s=-math.inf, microsteps=microsteps)


class World:
    """Physical state of the simulated bench.

    camera_seed: Seed of the sensor's fixed pattern: a camera keeps its pattern over runs with different
      seeds.
    clock: Returns world time in seconds; by default the machine's monotonic clock.
    """

    HISTORY_S = 120.0
    """How long past states are kept, s."""

    def __init__(
        self,
        truth: Truth | None = None,
        *,
        seed: int = 1,
        camera_seed: int = 50423,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.truth = truth if truth is not None else Truth()
        self.seed = seed
        self.camera_seed = camera_seed
        self._clock = clock
        self._on_since_s = clock()
        self._lock = threading.Lock()
        self._axes: dict[AxisName, History[AxisMotion]] = {}
        self._light = History(LightState())
        self._setup = History(setup_of(self.truth))

    def now_s(self) -> float:
        """Return the world time.

        Returns: Seconds of the world's clock.
        """
        return self._clock()

    # ------------------------------------------------------------- written by stages and lights

    def set_axis(self, name: AxisName, motion: AxisMotion, *, since_s: float | None = None) -> None:
        """Set the motion of an axis; an axis that was never set stands at zero.

        motion: Its motion until the next one is set.
        since_s: World time at which the motion begins; None: now. A time before the previous motion's is
          refused with `SimulationMisuse`.
        """
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            if name not in self._axes:
                self._axes[name] = History(motion)
                return
            self._axes[name].append(since, motion)
            self._axes[name].forget_before(since - self.HISTORY_S)

    def set_light(self, state: LightState, *, since_s: float | None = None) -> None:
        """Set the state of the light.

        state: Its state until the next one is set.
        since_s: World time at which the state begins; None: now. A time before the previous state's is
          refused with `SimulationMisuse`.
        """
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            self._light.append(since, state)
            self._light.forget_before(since - self.HISTORY_S)

    def shift_camera(self, shift_mm: tuple[float, float], *, since_s: float | None = None) -> None:
        """Move the camera across the beam.

        shift_mm: Displacement from where the camera was aligned, along the target's X and Y, mm; it replaces
          an earlier one.
        since_s: World time of the move; None: now. A time before the previous move's is refused with
          `SimulationMisuse`.
        """
        self.change_setup(lambda setup: replace(setup, shift_mm=shift_mm), since_s=since_s)

    def change_setup(
        self, change: Callable[[CameraSetup], CameraSetup], *, since_s: float | None = None
    ) -> CameraSetup:
        """Change what a person can change at the camera by hand.

        since_s: World time of the change; None: now. A time before the previous change's is refused with
          `SimulationMisuse`.
        """
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            setup = change(self._setup.latest)
            self._setup.append(since, setup)
            self._setup.forget_before(since - self.HISTORY_S)
        return setup

    # ------------------------------------------------------------- read by the camera

    def camera_shift_mm(self, t_s: float) -> tuple[float, float]:
        """Return where the camera stands across the beam at a time.

        Returns: Displacement along the target's X and Y, mm.
        """
        return self.camera_setup(t_s).shift_mm

    def camera_setup(self, t_s: float) -> CameraSetup:
        """Return how the camera is set up at a time."""
        with self._lock:
            return self._setup.at(t_s)

    def angles_deg(self, t_s: float) -> Mapping[AxisName, float]:
        """Return the angles of all axes at a time.

        Returns: Angles by axis, degrees; 0 for an axis that does not exist.
        """
        with self._lock:
            motions = {name: history.at(t_s) for name, history in self._axes.items()}
        angles: dict[AxisName, float] = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}
        angles.update({name: motion.angle_at(t_s) for name, motion in motions.items()})
        return angles

    def is_settled(self, t_s: float) -> bool:
        """Return whether no axis moves at a time.

        Returns: True if all axes have settled.
        """
        with self._lock:
            return all(h.at(t_s).settled_from_s <= t_s for h in self._axes.values())

    def resting_microsteps(self, t_s: float) -> Mapping[AxisName, int]:
        """Return where each axis rests, or will rest, by the motion of a time.

        Returns: Microsteps by axis, in alphabetical order; only axes that were set.
        """
        with self._lock:
            return {name: h.at(t_s).microsteps for name, h in sorted(self._axes.items())}

    def light(self, t_s: float) -> LightState:
        """Return the state of the light at a time.

        Returns: With voltages scaled to the lamp's light at the temperature of that time; of a board, as its
          light is seen.
        """
        with self._lock:
            state, setup = self._light.at(t_s), self._setup.at(t_s)
        share = temperature.lamp_brightness(self.truth.thermal, self.temperature_c(t_s))
        if share != 1.0:
            state = replace(state, low_v=state.low_v * share, high_v=state.high_v * share)
        if not self.truth.board.present or self.truth.board.blinks:
            return state
        truth = with_setup(self.truth, setup)
        flickers = placing.flickers(truth.board, placing.view_of(truth))
        return light_of_board(state, truth.board, flickers=flickers, on_since_s=self._on_since_s)

    def on_s(self, t_s: float) -> float:
        """Return the time since the bench was switched on."""
        return t_s - self._on_since_s

    def temperature_c(self, t_s: float) -> float:
        """Return the temperature of the camera at a time.

        Returns: Degrees Celsius, in steps of 0.01.
        """
        return temperature.temperature_c(self.truth.thermal, self.on_s(t_s))

    def truth_at(self, t_s: float) -> Truth:
        """Return the truth at the temperature of a time, with the camera as it is set up then.

        Returns: With focal lengths of that temperature; focus is in section ``lens``.
        """
        truth = temperature.truth_at_temperature(self.truth, self.temperature_c(t_s))
        return with_setup(truth, self.camera_setup(t_s))
