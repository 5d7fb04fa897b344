"""Axes that are EPICS motor records: one driver for all controllers that EPICS has a motor record for.

Fields of the record, by the motor record's manual: ``VAL`` target, ``RBV`` position, ``DMOV`` 1 at rest, ``HOMF`` and
``HOMR`` search the reference, ``STOP``, ``VELO`` and ``ACCL`` (s) speed and ramp, ``LLM`` and ``HLM`` limits, ``EGU``
unit, ``DESC`` description, ``MSTA`` states as bits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import MoveFailed, OutsideLimits
from drivers.stage import AxisIdentity, motion
from drivers.stage.motion import Axis as StageAxis
from drivers.stage.refusals import no_reference, not_movable, reads_otherwise
from drivers.stage.watched import AxisState, WatchedStage
from starbench_epics.records import MotorRecords

STALLED, PROBLEM, NO_CONTROLLER, HOMED = 1 << 6, 1 << 9, 1 << 12, 1 << 14
FAULTS = {STALLED: "slipped or stalled", PROBLEM: "a problem", NO_CONTROLLER: "no answer of the controller"}
BEGINS_S = 1.0
"""Longest time until a record shows that its axis moves, s."""


@dataclass(frozen=True, kw_only=True)
class EpicsAxis(StageAxis):
    """One axis, as the driver needs it."""

    record: str
    home: str

    @property
    def scale(self) -> float:
        """A record is asked for degrees."""
        return 1.0


class EpicsStage(WatchedStage[EpicsAxis]):
    """The driver. ``WatchedStage`` watches the moves; here is only what a motor record understands."""

    def __init__(self, axes: Sequence[EpicsAxis], *, clock: Clock) -> None:
        super().__init__(axes, clock=clock, where=", ".join(axis.record for axis in axes))
        self._records = self._share(MotorRecords([axis.record for axis in axes]))
        try:
            for axis in axes:
                self._check(axis)
            self._bring_to_rest()
        except BaseException:
            self._records.close()
            raise

    def _identity_of(self, axis: EpicsAxis) -> AxisIdentity:
        return AxisIdentity(axis.name, "EPICS", self._records.read_text(axis.record, "DESC"), "", "")

    def _check(self, axis: EpicsAxis) -> None:
        """Compare unit and limits of the record with the station file."""
        unit = self._records.read_text(axis.record, "EGU")
        if unit.lower() not in {"deg", "degree", "degrees"}:
            raise OutsideLimits(
                f"the record counts in {unit!r}, not in degrees (EGU).",
                where=axis.record,
                remedy="Set MRES and EGU of the record to degrees.",
            )
        ends = (axis.limits.lowest_deg - axis.zero_deg, axis.limits.highest_deg - axis.zero_deg)
        present = (self._read(axis, "LLM"), self._read(axis, "HLM"))
        motion.check_travel(axis.name, ends, present, "deg", to_deg=axis.to_angle_deg)

    # ------------------------------------------------------------ what WatchedStage needs

    def _has_reference(self) -> bool:
        """Whether this program has homed, and no record has lost it: another program's zero may be another one."""
        return self._was_homed() and all(self._status(axis) & HOMED for axis in self._axes.values())

    def _faults_of(self, axis: EpicsAxis) -> list[str]:
        status = self._status(axis)
        return [text for bit, text in FAULTS.items() if status & bit]

    def _check_ready(self, axis: EpicsAxis) -> None:
        if not self._has_reference():
            raise no_reference(axis)
        if faults := self._faults_of(axis):
            raise not_movable(axis, ", ".join(faults))

    def _clear_faults(self, axis: EpicsAxis) -> None:
        """Write speed and ramp before each homing; another program may have changed them."""
        speed, ramp_s = axis.limits.speed_deg_s, axis.limits.speed_deg_s / axis.limits.acceleration_deg_s2
        for field, value in {"VELO": speed, "ACCL": ramp_s}.items():
            self._records.write(axis.record, field, value)
            if abs((got := self._read(axis, field)) - value) > 0.01 * value:
                raise reads_otherwise(axis, field, f"{value:g}", f"{got:g}")

    def _reachable_deg(self, axis: EpicsAxis, angle_deg: float) -> float:  # noqa: ARG002
        """A record is asked for any angle; its controller rounds it."""
        return angle_deg

    def _begin_move(self, axis: EpicsAxis, angle_deg: float) -> None:
        self._records.write(axis.record, "VAL", angle_deg - axis.zero_deg)
        self._begins(axis, angle_deg)

    def _begin_homing(self, axis: EpicsAxis) -> None:
        """Start the search. A record that shows no motion has not searched, whatever its bit HOMED says."""
        self._records.write(axis.record, axis.home, 1)
        if not self._begins(axis, None):
            raise MoveFailed(
                "the record did not begin the search of the reference.",
                where=axis.name,
                remedy="Check that its controller can home, and in which direction (HOMF or HOMR).",
            )

    def _begins(self, axis: EpicsAxis, goal_deg: float | None) -> bool:
        """Wait until the record shows the motion, or stands at the goal; return whether it does."""
        ends_s = self._clock.monotonic() + BEGINS_S
        while self._clock.monotonic() < ends_s:
            state = self._read_state(axis)
            if state.busy or (
                goal_deg is not None and abs(state.position_deg - goal_deg) < axis.tolerance_deg
            ):
                return True
            self._clock.sleep(0.005)
        return False

    def _read_state(self, axis: EpicsAxis, *, homing: bool = False) -> AxisState:
        """Ask whether the axis is at rest, then where: the position of an axis at rest is then one at rest."""
        busy = not self._read(axis, "DMOV")
        problem = "" if homing else ", ".join(self._faults_of(axis))
        return AxisState(axis.to_angle_deg(self._read(axis, "RBV")), busy, problem)

    def _read_final_state(self, axis: EpicsAxis, *, homing: bool) -> AxisState:
        state = self._read_state(axis)
        if not self._status(axis) & HOMED:
            problem = "homing ended without a reference" if homing else "the record lost its reference"
            return state._replace(problem=problem)
        return state

    def _send_stop(self) -> None:
        with self._records.lock:
            for axis in self._axes.values():
                self._records.write(axis.record, "STOP", 1)

    def _read(self, axis: EpicsAxis, field: str) -> float:
        return self._records.read(axis.record, field)

    def _status(self, axis: EpicsAxis) -> int:
        return int(self._read(axis, "MSTA"))
