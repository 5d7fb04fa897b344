"""Motions of a GRBL controller: a queue of targets, and axes that start and arrive together.

Settings are known by number. Machine coordinates are in units from the switch, negative away from it; feeds are in
units/min. Lines and states are the controller's task. Reference: GRBL 1.1,
``planner.c`` and ``settings.h``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final, NamedTuple

from simulators.stages.axis_motion import Axis, AxisModel
from simulators.stages.gcode import NUMBER, GcodeError
from simulators.world.trajectory import LoadTrajectory

HOMING_FEED, HOMING_SEEK, PULL_OFF = 24, 25, 27  # Numbers of GRBL's settings
STEPS, MAX_RATE, ACCELERATION, MAX_TRAVEL = 100, 110, 120, 130  # Those of the first axis

#: Settings with decimals, apart from those of the axes.
_WITH_DECIMALS: Final = {11, 12, 24, 25, 27}

#: Time that a motor runs on when it is stopped in full motion, s; the counter does not notice, so steps are lost.
_RUN_ON_S: Final = 0.005


def must_be_positive(number: int) -> bool:
    """Return whether a setting is a scale, speed or acceleration: zero would make motion impossible."""
    return STEPS <= number < MAX_TRAVEL or number in {HOMING_FEED, HOMING_SEEK}


def factory_settings(models: Mapping[str, AxisModel], pull_off_deg: float) -> dict[int, float]:
    """Return the factory settings of X, Y and Z by their numbers, the lowest number first.

    Homing ends at the upper limit, ``pull_off_deg`` from the switch; the travel is from there to the lower limit.
    """
    settings = {0: 10.0, 1: 255.0} | dict.fromkeys(range(2, 7), 0.0)
    settings |= {10: 1.0, 11: 0.01, 12: 0.002, 13: 0.0}
    settings |= {20: 1.0, 21: 1.0, 22: 1.0, 23: 0.0, 24: 120.0, 25: 1200.0, 26: 250.0, 27: pull_off_deg}
    settings |= {30: 1000.0, 31: 0.0, 32: 0.0}
    for number, model in enumerate(models.values()):
        settings |= {
            STEPS + number: model.mechanics.counts_per_deg,
            MAX_RATE + number: model.speed_deg_s * 60.0,
            ACCELERATION + number: model.acceleration_deg_s2,
            MAX_TRAVEL + number: 2.0 * model.limit_deg + pull_off_deg,
        }
    return dict(sorted(settings.items()))


def format_setting(number: int, value: float) -> str:
    """Format a setting as GRBL prints it: whole-number settings without decimals, all others with three."""
    return f"{value:.3f}" if number in _WITH_DECIMALS or number >= STEPS else f"{value:.0f}"


def parse_setting(command: str) -> tuple[int, float]:
    """Parse a setting's change, after its ``$``, without blanks; `GcodeError` 2 bad number, 3 not a setting.

    >>> parse_setting("110=2400.5")
    (110, 2400.5)
    """
    number = NUMBER.match(command)
    if number is None:
        raise GcodeError(2)
    if command[number.end() : number.end() + 1] != "=":
        raise GcodeError(3)
    value = NUMBER.match(command, number.end() + 1)
    if value is None:
        raise GcodeError(2)
    if value.end() < len(command) or float(number[0]) > 255:
        raise GcodeError(3)
    return int(float(number[0])), float(value[0])


class Motion(NamedTuple):
    """A queued motion."""

    targets: dict[str, float]  # Machine coordinates by axis letter, units
    feed: float | None  # Feed, units/min; None for a rapid motion


class Planner:
    """The axes X, Y and Z and their queue of motions; ``settings`` may change while all rest."""

    def __init__(
        self,
        models: Mapping[str, AxisModel],
        settings: Mapping[int, float],
        now_s: float,
        publish: Callable[[str, LoadTrajectory], None],
    ) -> None:
        self._settings = settings
        self._order = list(models)

        self.axes = {
            model_letter: Axis(model.mechanics, now_s, partial(publish, model_letter))
            for model_letter, model in models.items()
        }
        self._queue: deque[Motion] = deque()

    # ------------------------------------------------------------------ queries
    def moving(self, now: float) -> bool:
        """Return whether an axis moves, or keeps reporting busy."""
        return any(axis.busy(now) or axis.stuck_busy for axis in self.axes.values())

    def reports_false_idle(self, now: float) -> bool:
        """Return whether a moving axis reports idle this once."""
        return any(axis.busy(now) and not axis.reports_busy(now) for axis in self.axes.values())

    def done(self, now: float) -> bool:
        """Return whether nothing moves and the queue is empty."""
        return not self._queue and not self.moving(now)

    def position(self, now: float) -> list[float]:
        """Return the machine position of three axes, units; 0 for missing axes."""
        positions = [axis.counter(now) / self._steps(letter) for letter, axis in self.axes.items()]
        return positions + [0.0] * (3 - len(positions))

    def feed(self, now: float) -> float:
        """Return the present speed along the path."""
        speeds = [axis.velocity(now) / self._steps(letter) for letter, axis in self.axes.items()]
        return 60.0 * math.sqrt(sum(speed * speed for speed in speeds))

    def final_target(self, now: float) -> dict[str, float]:
        """Return where all queued motions end."""
        return dict(self._queue[-1].targets) if self._queue else self._rest_targets(now)

    def inside(self, targets: Mapping[str, float]) -> bool:
        """Return whether targets lie within the travel of all axes."""
        return all(-self._setting(MAX_TRAVEL, letter) <= target <= 0.0 for letter, target in targets.items())

    # ------------------------------------------------------------------ commands
    def add(self, motion: Motion, now: float) -> None:
        """Append a motion to the queue."""
        self._queue.append(motion)
        self.go_on(now)

    def go_on(self, now: float) -> None:
        """Start the next motion if the last one has ended."""
        while self._queue and not self.moving(now):
            self._start(self._queue.popleft(), now)

    def cancel(self, now: float) -> None:
        """Brake, and empty the queue."""
        self.forget()
        self._brake(now)

    def forget(self) -> None:
        """Drop all motions that have not started."""
        self._queue.clear()

    def halt(self, now: float) -> None:
        """Cut the current of the motors: they run on a little, and steps are lost."""
        self.forget()
        for axis in self.axes.values():
            velocity = axis.velocity(now)
            axis.halt(now)
            axis.push(float(round(velocity * _RUN_ON_S)), now)

    def home(self, now: float) -> None:
        """Seek the switches with all axes at once."""
        for letter, axis in self.axes.items():
            scale = self._steps(letter)
            seek, feed = (self._settings[number] / 60.0 * scale for number in (HOMING_SEEK, HOMING_FEED))
            axis.home(now, seek, feed, self._setting(ACCELERATION, letter) * scale, set_counter=False)

    def homed(self, now: float) -> bool:
        """Set the counters after homing; False if a switch was not found."""
        for letter, axis in self.axes.items():
            axis.set_counter(-self._settings[PULL_OFF] * self._steps(letter), now)
        return all(axis.referenced(now) for axis in self.axes.values())

    # ------------------------------------------------------------------ internals
    def _start(self, motion: Motion, now: float) -> None:
        """Begin a straight line; its limits are the least of an axis's limit over the axis's share of the way."""
        present = self._rest_targets(now)
        distances = {letter: motion.targets[letter] - present[letter] for letter in self._order}
        length = math.sqrt(sum(distance * distance for distance in distances.values()))
        shares = {letter: abs(distance) / length for letter, distance in distances.items() if distance}
        if not shares:
            return
        speed = min(self._setting(MAX_RATE, letter) / 60.0 / share for letter, share in shares.items())
        speed = min(speed, motion.feed / 60.0) if motion.feed else speed
        acceleration = min(self._setting(ACCELERATION, letter) / share for letter, share in shares.items())
        for letter, share in shares.items():
            scale = self._steps(letter)
            target = float(round(motion.targets[letter] * scale))
            self.axes[letter].move_to(target, now, speed * share * scale, acceleration * share * scale)

    def _brake(self, now: float) -> None:
        for letter, axis in self.axes.items():
            if axis.busy(now):
                axis.stop(now, self._setting(ACCELERATION, letter) * self._steps(letter))

    def _rest_targets(self, now: float) -> dict[str, float]:
        return {letter: axis.rest_counter(now) / self._steps(letter) for letter, axis in self.axes.items()}

    def _steps(self, letter: str) -> float:
        return self._setting(STEPS, letter)

    def _setting(self, first: int, letter: str) -> float:
        return self._settings[first + self._order.index(letter)]
