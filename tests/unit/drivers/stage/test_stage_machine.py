"""Any order of commands, faults and losses: a stage moves when told to only, and never says that it is where it is not."""

from contextlib import suppress

import hypothesis.strategies as st
import pytest
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from drivers.errors import DriverError, NotHomed, OutsideLimits
from drivers.stage.zaber import ZaberAxis
from simulators.stages.axis_motion import MotionFault
from simulators.stages.zaber import CommandRejected, ZaberController
from tests.unit.drivers.stage import zaber_bench
from tests.unit.drivers.stage.zaber_bench import SCALE

pytestmark = pytest.mark.usefixtures("never_late")

AXES = st.sampled_from(["pan", "tilt"])
ANGLES = st.integers(-16 * SCALE, 16 * SCALE).map(lambda count: count / SCALE)


class Bench(RuleBasedStateMachine):
    """A stage in use, on controllers to which things happen."""

    @initialize(homed=st.booleans())
    def open(self, homed: bool) -> None:
        self.bench = zaber_bench.Bench()
        self.bench.line.spoil = self.spoil
        self.to_pass = self.to_lose = 0
        self.stage = self.bench.open()
        self.ordered = 0
        if homed:
            self.home()

    def spoil(self, line: bytes) -> bytes:
        if self.to_pass:
            self.to_pass -= 1
        elif self.to_lose:
            self.to_lose -= 1
            return b""
        return line

    def axis(self, name: str) -> ZaberController:
        return getattr(self.bench, name)

    def is_referenced(self) -> bool:
        return all(self.has_reference(name) for name in ("pan", "tilt"))

    def has_reference(self, name: str) -> bool:
        return self.axis(name).axis.referenced(self.bench.clock.now_s)

    # ------------------------------------------------------------ what somebody does
    @rule()
    def home(self) -> None:
        self.ordered = len(self.bench.motions()) + 2
        try:
            self.stage.home()
        except DriverError:
            return
        assert self.is_referenced()
        assert (self.bench.position("pan"), self.bench.position("tilt")) == (0, 0)

    @rule(target_deg=st.dictionaries(AXES, ANGLES, min_size=1), lose=st.none() | st.integers(0, 8))
    def move(self, target_deg: dict[str, float], lose: int | None) -> None:
        if lose is not None:
            self.to_pass, self.to_lose = lose, 1
        referenced = all(map(self.has_reference, target_deg))
        before = len(self.bench.motions())
        self.ordered = before + len(target_deg)
        try:
            self.stage.move_to(target_deg)
        except (OutsideLimits, NotHomed):
            assert len(self.bench.motions()) == before
            return
        except DriverError:
            assert referenced or len(self.bench.motions()) == before
            return
        assert referenced
        for name, angle in target_deg.items():
            assert abs(angle) <= 15.0
            # An axis that stops short of its target by no more than its tolerance has arrived.
            off_deg = (self.bench.position(name) - round(angle * SCALE)) / SCALE
            assert abs(off_deg) <= ZaberAxis.tolerance_deg
            assert not self.axis(name).axis.busy(self.bench.clock.now_s)

    @rule()
    def stop(self) -> None:
        try:
            self.stage.stop()
        except DriverError:
            return
        assert not self.bench.busy()

    @rule()
    def read(self) -> None:
        at_rest = not self.bench.busy()  # a lost reply takes time, in which an axis may come to rest
        try:
            angles_deg = self.stage.position_deg()
        except DriverError:
            return
        for name, angle in angles_deg.items():
            assert not at_rest or round(angle * SCALE) == self.bench.position(name)

    @rule()
    def begin_anew(self) -> None:
        """The program ends, and another opens the stage."""
        try:
            self.stage = self.bench.open()
        except DriverError:
            self.to_pass = self.to_lose = 0
            self.bench.clock.sleep(5.0)
            self.stage = self.bench.open()

    # ------------------------------------------------------------ what happens
    @rule(name=AXES)
    def restart(self, name: str) -> None:
        self.axis(name).restart(self.bench.clock.now_s)
        self.bench.clock.sleep(1.0)

    @rule(name=AXES, kind=st.sampled_from(["stall", "limit", "twist", "stop_short", "restart"]))
    def go_wrong_next_time(self, name: str, kind: str) -> None:
        self.axis(name).axis.arm(MotionFault(kind))

    @rule(name=AXES, released=st.booleans())
    def press_the_stop(self, name: str, released: bool) -> None:
        self.axis(name).emergency_stop(self.bench.clock.now_s, released=released)

    @rule(first=st.integers(0, 15), count=st.integers(1, 12))
    def lose_replies(self, first: int, count: int) -> None:
        self.to_pass, self.to_lose = first, count

    @rule(name=AXES)
    def somebody_turns_the_knob(self, name: str) -> None:
        with suppress(CommandRejected):
            self.axis(name).execute(1, ["move", "rel", "500"], self.bench.clock.now_s)

    @rule(seconds=st.floats(0.0, 5.0))
    def wait(self, seconds: float) -> None:
        self.bench.clock.sleep(seconds)

    @precondition(lambda self: hasattr(self, "bench"))
    @invariant()
    def only_what_was_ordered_has_been_sent(self) -> None:
        assert len(self.bench.motions()) <= self.ordered


Bench.TestCase.settings = settings(max_examples=50, stateful_step_count=30, deadline=None)
TestBench = Bench.TestCase
