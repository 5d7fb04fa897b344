"""Expected duration and disk space of the steps of a plan, by the station's speeds and by the allowances below."""

from __future__ import annotations

import math
from collections.abc import Mapping

from bench.stations.sections import AxisConfig
from bench.stations.station import Station
from bench.stations.station_cameras import FrameCameraConfig
from bench.views.recording_window import recording_duration_s
from sequences.script import (
    ChooseStep,
    LightStep,
    MoveStep,
    PromptStep,
    RecordStep,
    ReportStep,
    SettleStep,
    SolveStep,
    Step,
    WaitStep,
)

# Allowances, measured on the simulated bench. The devices of a real bench need more.
PREFLIGHT_S = 1.1
HOMING_EXTRA_S = 0.5
LIGHT_ON_S = 0.7
LIGHT_OFF_S = 0.05
MOVE_EXTRA_S = 0.1
RECORD_EXTRA_S = 1.0
CHECK_S = 0.5
SOLVE_S = 0.3
CHOOSE_S = 2.0
"""Calibration from the poses so far, and the choice of the next one."""
REPORT_S = 0.5
RECORDING_BYTES_PER_S = 35e6
"""Recording of a lit target with square flicker. The link of a camera carries about five times as much."""
MOST_BYTES_PER_EVENT = 4
PICTURE_S = 0.04
PICTURE_SIZE = (1280, 720)
"""Size of a frame camera's picture if the station has no ``expected`` section, px."""
POSE_BYTES = 200_000
"""Images, stars and logs of one pose."""
REPORT_BYTES = 1_000_000


def travel_s(distance_deg: float, speed_deg_s: float, acceleration_deg_s2: float) -> float:
    """Return the duration of a move with a trapezoidal speed profile.

    distance_deg: Distance, deg; the sign does not matter.
    speed_deg_s: Highest speed, deg/s.
    acceleration_deg_s2: Acceleration and deceleration, deg/s^2.
    Returns: Duration, s.

    Examples
    --------
    >>> travel_s(10, speed_deg_s=10, acceleration_deg_s2=100)
    1.1
    >>> travel_s(1, speed_deg_s=10, acceleration_deg_s2=100)
    0.2
    """
    distance = abs(distance_deg)
    ramps = speed_deg_s**2 / acceleration_deg_s2
    if distance < ramps:  # too short to reach full speed
        return 2 * math.sqrt(distance / acceleration_deg_s2)
    return distance / speed_deg_s + speed_deg_s / acceleration_deg_s2


class Estimate:
    """Estimates duration and disk space step by step; keeps the position of the stage and the state of the light.

    An ``until`` counts with all recordings that it allows, as far as they fit into its minutes. Its chosen poses are as
    far apart as the stage's limits allow. Rounds for poses that may fail take no time and no expected disk space.

    size_bytes, most_bytes: Disk space so far, as in a `Plan`.
    """

    def __init__(self, station: Station) -> None:
        self.size_bytes = self.most_bytes = REPORT_BYTES
        self._axes: Mapping[str, AxisConfig] = station.axes
        camera = station.camera
        self._pictures = camera.pictures if isinstance(camera, FrameCameraConfig) else 0
        self._picture_bytes = math.prod(station.expected.image_size if station.expected else PICTURE_SIZE)
        self._at_deg: dict[str, float] = dict.fromkeys(self._axes, 0.0)
        self._frequency_hz: float | None = None
        self._elapsed_s = 0.0
        self._until_begin_s: dict[int, float] = {}  # by number of the first step of an until
        self._spare = False  # whether the present round is one that only failed poses make necessary

    def preparation_s(self) -> float:
        """Return the time before the first step: open and identify the devices, home over the whole range.

        Returns: Time, s.
        """
        ranges = {name: axis.limits_deg[1] - axis.limits_deg[0] for name, axis in self._axes.items()}
        return PREFLIGHT_S + self._travel_s(ranges) + HOMING_EXTRA_S

    def parking_s(self) -> float:
        """Return the time after the last step that needs devices: light off, stage to 0 deg.

        Returns: Time, s.
        """
        return LIGHT_OFF_S + self._travel_s(self._at_deg) + MOVE_EXTRA_S

    def add(self, step: Step) -> float:
        """Add the next step.

        Returns: Its duration, s; its disk space is added to the sizes.
        """
        if isinstance(step, ChooseStep):
            self._spare = self._is_spare(step)
        sizes = self.size_bytes
        duration_s = self._duration_s(step)
        if self._spare and isinstance(step, ChooseStep | MoveStep | SettleStep | RecordStep):
            self.size_bytes, duration_s = sizes, 0.0
        self._elapsed_s += duration_s
        return duration_s

    def _is_spare(self, step: ChooseStep) -> bool:
        """Return whether a round of an ``until`` is beyond its recordings or its minutes; its last step never is."""
        until = step.until
        if step.pose is None:
            return False
        number = step.pose.index - until.poses.start
        begin_s = self._until_begin_s.setdefault(until.first, self._elapsed_s)
        late = until.minutes is not None and self._elapsed_s - begin_s > 60.0 * until.minutes
        return number >= until.at_most or late

    def _duration_s(self, step: Step) -> float:
        match step:
            case ChooseStep():
                duration_s = CHOOSE_S
            case MoveStep() if step.pose.chosen_in_run:
                duration_s = self._move_anywhere()
            case LightStep():
                self._frequency_hz = step.flicker.frequency_hz if step.flicker else None
                duration_s = LIGHT_ON_S if step.flicker else LIGHT_OFF_S
            case MoveStep():
                duration_s = self._move(step.pose.angles_deg)
            case RecordStep():
                duration_s = self._record(step) + RECORD_EXTRA_S + CHECK_S
            case SettleStep() | WaitStep():
                duration_s = step.duration_s
            case PromptStep():
                duration_s = step.timeout_s
            case SolveStep():
                duration_s = SOLVE_S
            case ReportStep():
                duration_s = REPORT_S
        return duration_s

    def _record(self, step: RecordStep) -> float:
        if self._pictures:
            pixel_bytes = self._pictures * self._picture_bytes
            self.size_bytes += pixel_bytes + POSE_BYTES
            self.most_bytes += 2 * pixel_bytes * step.attempts + POSE_BYTES  # 16 bit
            return self._pictures * PICTURE_S
        if self._frequency_hz is None:  # in the dark, which `check_script` forbids
            recorded_s = step.window_ms * 1e-3
        else:
            recorded_s = recording_duration_s(step.window_ms, self._frequency_hz)
        most_events = step.gates.max_event_rate_mev_s * 1e6 * recorded_s
        self.size_bytes += int(recorded_s * RECORDING_BYTES_PER_S) + POSE_BYTES
        self.most_bytes += int(most_events * MOST_BYTES_PER_EVENT * step.attempts) + POSE_BYTES
        return recorded_s

    def _move_anywhere(self) -> float:
        """Return the time of a move over the whole range; the farthest end is the place to park from."""
        ranges = {name: axis.limits_deg[1] - axis.limits_deg[0] for name, axis in self._axes.items()}
        self._at_deg |= {name: max(axis.limits_deg, key=abs) for name, axis in self._axes.items()}
        return self._travel_s(ranges) + MOVE_EXTRA_S

    def _move(self, target_deg: Mapping[str, float]) -> float:
        distances = {name: angle - self._at_deg.get(name, 0.0) for name, angle in target_deg.items()}
        self._at_deg |= target_deg
        return self._travel_s(distances) + MOVE_EXTRA_S

    def _travel_s(self, distances_deg: Mapping[str, float]) -> float:
        """Return the time of the slowest axis, s. An axis that the station does not have is a fault of the script."""
        return max(
            (
                travel_s(distance, self._axes[name].speed_deg_s, self._axes[name].acceleration_deg_s2)
                for name, distance in distances_deg.items()
                if name in self._axes
            ),
            default=0.0,
        )
