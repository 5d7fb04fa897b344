"""The simulated world: where the axes point and what the light does, at every moment.

Simulated stages and lights write into it, the simulated camera reads from it; none knows the others. The
past is kept, so that a camera that computes a recording a little late still sees what happened then. Knows
no protocol and no optics. Thread-safe.
"""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Generic, Literal, TypeVar

from simulators.errors import SimulationMisuse
from simulators.world import temperature
from simulators.world.sync_line import SyncLine
from simulators.world.truth import Truth

AxisName = Literal["pan", "tilt", "roll"]
Waveform = Literal["square", "sine"]

FULL_DRIVE_V = 5.0
"""Drive voltage at which the light gives its nominal brightness; below, it is proportional."""


@dataclass(frozen=True)
class AxisMotion:
    """How an axis moves from some moment on, until its next motion is set.

    Attributes
    ----------
    angle_at
        Angle in degrees at a world time in seconds. Must be pure: the same time gives the same angle.
    settled_from_s
        World time from which on the angle no longer changes; ``math.inf`` for a motion without end.
    microsteps
        Where the axis rests after ``settled_from_s``: the position a recording's noise is keyed to.
    """

    angle_at: Callable[[float], float]
    settled_from_s: float
    microsteps: int

    @classmethod
    def resting(cls, angle_deg: float, microsteps: int) -> AxisMotion:
        """Make an axis that stands still."""
        return cls(angle_at=lambda _t_s: angle_deg, settled_from_s=-math.inf, microsteps=microsteps)


@dataclass(frozen=True)
class LightState:
    """What the light's driver gives from some moment on.

    Attributes
    ----------
    origin_s
        World time at which a period begins. A period begins with the rising sync edge: the start of a
        square's high part, the upward crossing of a sine's middle.
    output
        Whether the light is driven at all; if not, it is dark.
    sync
        Whether sync edges reach the camera's trigger input (rising at the start of a period, falling at the
        end of a square's high part or at half of a sine's period).
    sync_line
        The cable they take.
    """

    waveform: Waveform = "square"
    frequency_hz: float = 60.0
    duty_percent: float = 50.0
    low_v: float = 0.0
    high_v: float = 5.0
    output: bool = False
    sync: bool = False
    origin_s: float = 0.0
    sync_line: SyncLine = field(default_factory=SyncLine)

    @property
    def low(self) -> float:
        """Lower brightness, nominal brightness = 1 (zero when the output is off)."""
        return max(0.0, self.low_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def high(self) -> float:
        """Upper brightness, nominal brightness = 1 (zero when the output is off)."""
        return max(0.0, self.high_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def period_us(self) -> float:
        """Length of a period."""
        return 1e6 / self.frequency_hz

    @property
    def high_share(self) -> float:
        """Share of a period during which the sync line (and a square) is high."""
        return self.duty_percent / 100.0 if self.waveform == "square" else 0.5

    def phase_at(self, t_s: float) -> float:
        """Phase in periods, 0 <= phase < 1, at a world time."""
        phase = ((t_s - self.origin_s) * self.frequency_hz) % 1.0
        return phase if phase < 1.0 else 0.0  # just below a whole period, the remainder rounds up to 1

    def settings(self) -> tuple[object, ...]:
        """All but the origin: what a recording's noise is keyed to."""
        return (
            self.waveform,
            self.frequency_hz,
            self.duty_percent,
            self.low,
            self.high,
            self.output,
            self.sync,
        )


_State = TypeVar("_State")


class _History(Generic[_State]):
    """A state over time: the one that was valid at a moment can be asked for later."""

    def __init__(self, first: _State) -> None:
        self._since: list[float] = [-math.inf]
        self._states: list[_State] = [first]

    def append(self, since_s: float, state: _State) -> None:
        """Take the state from a moment on, not earlier than the last one's."""
        if since_s < self._since[-1]:
            raise SimulationMisuse(f"A state at {since_s} s after one at {self._since[-1]} s.")
        self._since.append(since_s)
        self._states.append(state)

    def at(self, t_s: float) -> _State:
        """Look up the state that was, or is, valid at that moment."""
        return self._states[bisect_right(self._since, t_s) - 1]

    def forget_before(self, t_s: float) -> None:
        """Drop what ended before that moment."""
        first = bisect_right(self._since, t_s) - 1
        del self._since[:first]
        del self._states[:first]


class World:
    """The simulated bench's physical state.

    Parameters
    ----------
    truth
        The numbers a calibration is to find.
    seed
        Seed of everything random over time.
    camera_seed
        Seed of the sensor's fixed pattern: the same camera has the same one over all seeds of runs.
    clock
        World time in seconds; the machine's monotonic clock unless a test gives its own.
    """

    HISTORY_S = 120.0
    """How long the past is kept."""

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
        self._axes: dict[AxisName, _History[AxisMotion]] = {}
        self._light = _History(LightState())

    def now_s(self) -> float:
        """World time, seconds."""
        return self._clock()

    # ------------------------------------------------------------- written by stages and lights

    def set_axis(self, name: AxisName, motion: AxisMotion, *, since_s: float | None = None) -> None:
        """Let an axis move that way from now (or ``since_s``) on; an axis never set stands at zero."""
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            if name not in self._axes:
                self._axes[name] = _History(motion)
                return
            self._axes[name].append(since, motion)
            self._axes[name].forget_before(since - self.HISTORY_S)

    def set_light(self, state: LightState, *, since_s: float | None = None) -> None:
        """Let the light behave that way from now (or ``since_s``) on."""
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            self._light.append(since, state)
            self._light.forget_before(since - self.HISTORY_S)

    # ------------------------------------------------------------- read by the camera

    def angles_deg(self, t_s: float) -> Mapping[AxisName, float]:
        """Angles of all axes at a world time, degrees; axes that are not there stand at zero."""
        with self._lock:
            motions = {name: history.at(t_s) for name, history in self._axes.items()}
        angles: dict[AxisName, float] = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}
        angles.update({name: motion.angle_at(t_s) for name, motion in motions.items()})
        return angles

    def is_settled(self, t_s: float) -> bool:
        """Whether no axis moves at that time."""
        with self._lock:
            return all(h.at(t_s).settled_from_s <= t_s for h in self._axes.values())

    def resting_microsteps(self, t_s: float) -> Mapping[AxisName, int]:
        """Where each axis rests, or will rest, as of that time."""
        with self._lock:
            return {name: h.at(t_s).microsteps for name, h in sorted(self._axes.items())}

    def light(self, t_s: float) -> LightState:
        """Look up what the light did, or does, at that time."""
        with self._lock:
            state = self._light.at(t_s)
        share = temperature.brightness(self.truth.thermal, self.temperature_c(t_s))
        return (
            state if share == 1.0 else replace(state, low_v=state.low_v * share, high_v=state.high_v * share)
        )

    def on_s(self, t_s: float) -> float:
        """Seconds from when the bench was switched on."""
        return t_s - self._on_since_s

    def temperature_c(self, t_s: float) -> float:
        """Temperature of the camera at that time."""
        return temperature.temperature_c(self.truth.thermal, self.on_s(t_s))

    def truth_at(self, t_s: float) -> Truth:
        """Give the truth as it is at that time: what follows the temperature has followed it."""
        return temperature.warmed(self.truth, self.temperature_c(t_s))
