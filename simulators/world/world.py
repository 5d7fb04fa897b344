"""The simulated world: angles of the axes, state of the light and setup of the camera at every moment.

Simulated stages and lights write into it, and the simulated camera reads from it; they do not use each other. The past
is kept, so that a camera that computes a recording a little late still gets the past state. This module uses no
protocol and no optics. `World` is thread-safe.
"""

from __future__ import annotations

import hashlib
import math
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from simulators.errors import SimulationMisuse
from simulators.world import drift
from simulators.world.truth import LensTruth, Truth

AxisName = Literal["pan", "tilt", "roll"]
Waveform = Literal["square", "sine"]

FULL_DRIVE_V = 5.0
"""Drive voltage at which the light has its nominal brightness; brightness is proportional to the voltage."""

IntArray = NDArray[np.int64]
_State = TypeVar("_State")


@dataclass(frozen=True)
class SyncLine:
    """A cable; by default without faults."""

    inverted: bool = False  # Whether it swaps high and low
    missing_every: int = 0  # Both edges of every n-th period are lost; 0 for never
    extra_every: int = 0  # Every n-th period has a short false pulse in its low part; 0 for never
    jitter_us: float = 0.0
    # Share of the edges that do not cross the input's threshold, because the level is too low.
    lost_share: float = 0.0
    channel: int = 0

    def carry(
        self, periods: IntArray, rising: IntArray, falling: IntArray, period_us: float
    ) -> tuple[IntArray, NDArray[np.uint8]]:
        """Carry the edges of periods: times in order, us, and the level after each edge, plus twice the channel.

        The periods' numbers and their ``rising`` and ``falling`` edges, us, are (N,) int64; all periods have one
        length, us.

        >>> k = np.arange(4)
        >>> SyncLine(missing_every=2).carry(k, 100 * k, 100 * k + 50, 100.0)[0].tolist()
        [100, 150, 300, 350]
        """
        kept = np.ones(len(periods), bool)
        if self.missing_every:
            kept = periods % self.missing_every != 0
        t = np.concatenate([rising[kept], falling[kept]])
        value = np.repeat(np.array([1, 0], np.uint8), kept.sum())
        if self.jitter_us:
            shift = np.concatenate([_noise(2 * periods[kept]), _noise(2 * periods[kept] + 1)])
            t = t + np.round(self.jitter_us * shift).astype(np.int64)
        if self.extra_every:
            begins = falling[periods % self.extra_every == 0] + round(0.1 * period_us)
            t = np.concatenate([t, begins, begins + round(0.05 * period_us)])
            value = np.concatenate([value, np.repeat(np.array([1, 0], np.uint8), len(begins))])
        if self.lost_share:
            stays = 0.5 * (_noise(t) + 1.0) >= self.lost_share
            t, value = t[stays], value[stays]
        order = np.argsort(t, kind="stable")
        return t[order], (value[order] ^ np.uint8(self.inverted)) | np.uint8(self.channel << 1)


def _noise(numbers: IntArray) -> NDArray[np.float64]:
    """Return a fixed pseudo-random value in -1 to 1 for each number: SplitMix64 (Steele, Lea and Flood 2014)."""
    z = numbers.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return (z ^ (z >> np.uint64(31))).astype(np.float64) / 2.0**63 - 1.0


@dataclass(frozen=True)
class LightState:
    """Output of the light's driver from some moment on."""

    waveform: Waveform = "square"  # "square" or "sine"
    frequency_hz: float = 60.0
    duty_percent: float = 50.0  # Length of a square's high part, as a percentage of the period
    low_v: float = 0.0
    high_v: float = 5.0
    output: bool = False  # Whether the light is driven at all; if not, it is dark
    # Whether sync edges reach the camera's trigger input (rising at the start of a period, falling at the end
    # of a square's high part or at half of a sine's period).
    sync: bool = False
    # World time at which a period begins. A period begins with the rising sync edge: the start of a square's
    # high part, or the upward crossing of a sine's middle.
    origin_s: float = 0.0
    sync_line: SyncLine = field(default_factory=SyncLine)

    @property
    def low(self) -> float:
        """Lower brightness, nominal brightness = 1 (zero if the output is off)."""
        return max(0.0, self.low_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def high(self) -> float:
        """Upper brightness, nominal brightness = 1 (zero if the output is off)."""
        return max(0.0, self.high_v) / FULL_DRIVE_V if self.output else 0.0

    @property
    def period_us(self) -> float:
        """Length of a period, us."""
        return 1e6 / self.frequency_hz

    @property
    def high_share(self) -> float:
        """Share of a period during which the sync line (and a square) is high."""
        return self.duty_percent / 100.0 if self.waveform == "square" else 0.5

    def phase_at(self, t_s: float) -> float:
        """Return the light's phase at a time."""
        phase = ((t_s - self.origin_s) * self.frequency_hz) % 1.0
        return phase if phase < 1.0 else 0.0  # just below a whole period, the remainder rounds up to 1

    def settings(self) -> tuple[object, ...]:
        """Return everything but the origin and the cable, from which a recording's noise is seeded."""
        return (
            self.waveform,
            self.frequency_hz,
            self.duty_percent,
            self.low,
            self.high,
            self.output,
            self.sync,
        )


@dataclass(frozen=True)
class CameraSetup:
    """How the camera stands in its mount, and how its lens is set."""

    # Displacement across the beam from where the camera was aligned, along the target's X and Y.
    shift_mm: tuple[float, float]
    turn_deg: tuple[float, float, float]
    lens: LensTruth


def setup_of(truth: Truth) -> CameraSetup:
    """Return the camera's setup in a truth."""
    return CameraSetup(truth.mount.shift_mm, truth.mount.turn_deg, truth.lens)


def with_setup(truth: Truth, setup: CameraSetup) -> Truth:
    """Return the truth with the camera set up in another way; the same object if it is set up so already."""
    if setup == setup_of(truth):
        return truth
    mount = replace(truth.mount, shift_mm=setup.shift_mm, turn_deg=setup.turn_deg)
    return replace(truth, mount=mount, lens=setup.lens)


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
        """Return the motion of an axis that stands still."""
        return cls(angle_at=lambda _t_s: angle_deg, settled_from_s=-math.inf, microsteps=microsteps)


class History(Generic[_State]):
    """A state over time: past states can be looked up; ``first`` holds before the first one that is appended."""

    KEPT_S = 120.0
    """How long past states are kept, s: a camera that computes for long still asks for the past."""

    def __init__(self, first: _State) -> None:
        self._since: list[float] = [-math.inf]
        self._states: list[_State] = [first]

    def append(self, since_s: float, state: _State) -> None:
        """Set the state from a moment on; states that ended ``KEPT_S`` before it are dropped."""
        if since_s < self._since[-1]:
            raise SimulationMisuse(
                f"A state at {since_s} s cannot follow one at {self._since[-1]} s.",
                remedy="Set states in order of time.",
            )
        self._since.append(since_s)
        self._states.append(state)
        first = bisect_right(self._since, since_s - self.KEPT_S) - 1
        del self._since[:first]
        del self._states[:first]

    def at(self, t_s: float) -> _State:
        """Return the state at a moment."""
        return self._states[bisect_right(self._since, t_s) - 1]

    @property
    def latest(self) -> _State:
        """State that was appended last."""
        return self._states[-1]


class World:
    """Physical state of the simulated bench; ``clock`` is its time, s, by default the machine's."""

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
        self.now_s = clock
        """Returns the world time."""
        self._on_since_s = clock()
        self._lock = threading.Lock()
        self._axes: dict[AxisName, History[AxisMotion]] = {}
        self._light = History(LightState())
        self._setup = History(setup_of(self.truth))

    def recording_seed(self, key: str, repeats: dict[str, int]) -> np.random.SeedSequence:
        """Return the seeds of a recording, whose content ``key`` tells; ``repeats`` counts those with the same."""
        repeat = repeats.get(key, 0)
        repeats[key] = repeat + 1
        digest = hashlib.sha256(key.encode()).digest()
        return np.random.SeedSequence([self.seed, repeat, *np.frombuffer(digest[:16], "<u4").tolist()])

    # ------------------------------------------------------------- written by stages and lights

    def set_axis(self, name: AxisName, motion: AxisMotion, *, since_s: float | None = None) -> None:
        """Set an axis's motion from a world time (None: now) on; `SimulationMisuse` before the last one's."""
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            if name in self._axes:
                self._axes[name].append(since, motion)
            else:
                self._axes[name] = History(motion)

    def set_light(self, state: LightState, *, since_s: float | None = None) -> None:
        """Set the state of the light from a world time (None: now) on; before the previous state's, it is refused."""
        with self._lock:
            self._light.append(self.now_s() if since_s is None else since_s, state)

    def change_setup(
        self, change: Callable[[CameraSetup], CameraSetup], *, since_s: float | None = None
    ) -> CameraSetup:
        """Change the camera as by hand at a world time (None: now); before the previous change's, it is refused."""
        with self._lock:
            since = self.now_s() if since_s is None else since_s
            setup = change(self._setup.latest)
            self._setup.append(since, setup)
        return setup

    # ------------------------------------------------------------- read by the camera

    def camera_setup(self, t_s: float) -> CameraSetup:
        """Return how the camera is set up at a time."""
        with self._lock:
            return self._setup.at(t_s)

    def angles_deg(self, t_s: float) -> Mapping[AxisName, float]:
        """Return the angles of all axes at a time, degrees; 0 for an axis that does not exist."""
        with self._lock:
            motions = {name: history.at(t_s) for name, history in self._axes.items()}
        angles: dict[AxisName, float] = {"pan": 0.0, "tilt": 0.0, "roll": 0.0}
        angles.update({name: motion.angle_at(t_s) for name, motion in motions.items()})
        return angles

    def is_settled(self, t_s: float) -> bool:
        """Return whether no axis moves at a time."""
        with self._lock:
            return all(h.at(t_s).settled_from_s <= t_s for h in self._axes.values())

    def resting_microsteps(self, t_s: float) -> Mapping[AxisName, int]:
        """Return where each axis that was set rests, or will rest, by its motion at a time, in the order of names."""
        with self._lock:
            return {name: h.at(t_s).microsteps for name, h in sorted(self._axes.items())}

    def situation(self, t_s: float) -> dict[str, Any]:
        """Return what decides the content of a recording at a time: where the axes rest, and the light."""
        return {
            "microsteps": dict(self.resting_microsteps(t_s)),
            "settled": self.is_settled(t_s),
            "light": self.light(t_s).settings(),
        }

    def light(self, t_s: float) -> LightState:
        """Return the light at a time."""
        with self._lock:
            return self._light.at(t_s)

    def on_s(self, t_s: float) -> float:
        """Return the time since the bench was switched on."""
        return t_s - self._on_since_s

    def temperature_c(self, t_s: float) -> float:
        """Return the temperature of the camera at a time."""
        return drift.temperature_c(self.truth.thermal, self.on_s(t_s))

    def truth_at(self, t_s: float) -> Truth:
        """Return the truth at a time, with its temperature's focal lengths, and focus in section ``lens``."""
        truth = drift.truth_at_temperature(self.truth, self.truth.thermal, self.temperature_c(t_s))
        return with_setup(truth, self.camera_setup(t_s))
