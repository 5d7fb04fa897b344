"""Motions of a GRBL controller: a queue of targets, and axes that begin and arrive together.

Knows settings by number, machine coordinates (units from the switch, negative away from it), feeds in units a
minute, hold and resume; knows no line and no state.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from simulators.stages.axis_motion import Axis, Mechanics
from simulators.world.trajectory import Pointing

HOMING_FEED, HOMING_SEEK, PULL_OFF = 24, 25, 27
STEPS, MAX_RATE, ACCELERATION, MAX_TRAVEL = 100, 110, 120, 130

#: How long a motor that is stopped in full motion runs on, unknown to the counter: that is how steps are lost.
_RUN_ON_S: Final = 0.005


def must_be_positive(number: int) -> bool:
    """Tell whether a setting is a scale, a speed or an acceleration, with which nothing moves at zero."""
    return STEPS <= number < MAX_TRAVEL or number in {HOMING_FEED, HOMING_SEEK}


@dataclass(frozen=True)
class GrblAxisModel:
    """One axis.

    Attributes
    ----------
    mechanics
        What it is built of; ``home_deg`` is where homing ends, the pull-off below the switch.
    travel_deg
        From the switch to the other end.
    """

    mechanics: Mechanics
    travel_deg: float
    max_rate_deg_s: float = 40.0
    acceleration_deg_s2: float = 200.0


class Motion(NamedTuple):
    """A motion to come: where it leads, and its feed where it has one."""

    targets: dict[str, float]
    feed: float | None


class Planner:
    """The axes of a controller and what they are still to do.

    Parameters
    ----------
    models
        Axes by letter, of X, Y and Z in this order.
    settings
        The controller's, by number; they may change while all rests.
    now_s
        Time of power-up.
    publish
        Called with an axis's letter and every new course of it.
    """

    def __init__(
        self,
        models: Mapping[str, GrblAxisModel],
        settings: Mapping[int, float],
        now_s: float,
        publish: Callable[[str, Pointing], None],
    ) -> None:
        self._settings = settings
        self._order = list(models)

        def publisher(letter: str) -> Callable[[Pointing], None]:
            return lambda pointing: publish(letter, pointing)

        self.axes = {one: Axis(model.mechanics, now_s, publisher(one)) for one, model in models.items()}
        self.held = False
        self._queue: deque[Motion] = deque()
        self._current: Motion | None = None

    # ------------------------------------------------------------------ questions
    def moving(self, now: float) -> bool:
        """Whether an axis moves, or is stuck saying so."""
        return any(axis.busy(now) or axis.stuck_busy for axis in self.axes.values())

    def reports_false_idle(self, now: float) -> bool:
        """Whether an axis that moves says, this once, that it does not."""
        return any(axis.busy(now) and not axis.reports_busy(now) for axis in self.axes.values())

    def done(self, now: float) -> bool:
        """Whether nothing moves and nothing is left to do."""
        return not self._queue and not self.held and not self.moving(now)

    def position(self, now: float) -> list[float]:
        """Machine position of three axes, units; 0 for those that are not there."""
        found = [axis.counter(now) / self._steps(letter) for letter, axis in self.axes.items()]
        return found + [0.0] * (3 - len(found))

    def feed(self, now: float) -> float:
        """Present speed along the path, units a minute."""
        speeds = [axis.velocity(now) / self._steps(letter) for letter, axis in self.axes.items()]
        return 60.0 * math.sqrt(sum(speed * speed for speed in speeds))

    def final_target(self, now: float) -> dict[str, float]:
        """Where everything that was ordered ends."""
        return dict(self._queue[-1].targets) if self._queue else self._rest_targets(now)

    def inside(self, targets: Mapping[str, float]) -> bool:
        """Whether targets lie within the travel of all axes."""
        return all(-self._setting(MAX_TRAVEL, one) <= target <= 0.0 for one, target in targets.items())

    # ------------------------------------------------------------------ orders
    def add(self, motion: Motion, now: float) -> None:
        """Let a motion follow those before it."""
        self._queue.append(motion)
        self.go_on(now)

    def go_on(self, now: float) -> None:
        """Begin the next motion if the last one has ended."""
        while self._queue and not self.held and not self.moving(now):
            self._current = self._queue.popleft()
            self._start(self._current, now)

    def hold(self, now: float) -> None:
        """Brake, and keep what is left to do."""
        if self._current is not None and not self.held:
            self._queue.appendleft(self._current)
        self.held = True
        self._brake(now)

    def resume(self, now: float) -> None:
        """Go on after a hold."""
        self.held = False
        self.go_on(now)

    def cancel(self, now: float) -> None:
        """Brake, and forget what is left to do."""
        self.forget()
        self._brake(now)

    def forget(self) -> None:
        """Drop all motions that have not begun."""
        self._queue.clear()
        self.held = False

    def halt(self, now: float) -> None:
        """Cut the motors' current: they run on a little, and steps are lost."""
        self.forget()
        for axis in self.axes.values():
            velocity = axis.velocity(now)
            axis.halt(now)
            axis.push(float(round(velocity * _RUN_ON_S)), now)

    def home(self, now: float) -> None:
        """Seek the switches, all axes at once."""
        for letter, axis in self.axes.items():
            scale = self._steps(letter)
            seek, feed = (self._settings[number] / 60.0 * scale for number in (HOMING_SEEK, HOMING_FEED))
            axis.home(now, seek, feed, self._setting(ACCELERATION, letter) * scale, set_counter=False)

    def homed(self, now: float) -> bool:
        """Set the counters after homing; False if a switch was not found."""
        for letter, axis in self.axes.items():
            axis.set_counter(-self._settings[PULL_OFF] * self._steps(letter), now)
        return all(axis.referenced(now) for axis in self.axes.values())

    # ------------------------------------------------------------------ inside
    def _start(self, motion: Motion, now: float) -> None:
        present = self._rest_targets(now)
        distances = {one: motion.targets[one] - present[one] for one in self._order}
        length = math.sqrt(sum(distance * distance for distance in distances.values()))
        shares = {one: abs(distance) / length for one, distance in distances.items() if distance}
        if not shares:
            return
        speed = min(self._setting(MAX_RATE, one) / 60.0 / share for one, share in shares.items())
        speed = min(speed, motion.feed / 60.0) if motion.feed else speed
        acceleration = min(self._setting(ACCELERATION, one) / share for one, share in shares.items())
        for one, share in shares.items():
            scale = self._steps(one)
            target = float(round(motion.targets[one] * scale))
            self.axes[one].move_to(target, now, speed * share * scale, acceleration * share * scale)

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
