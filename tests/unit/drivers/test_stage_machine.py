"""Any order of commands, faults and losses: a stage moves when told to only, and never says that it is where it is not."""

from __future__ import annotations

import hypothesis.strategies as st
from hypothesis import settings
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from drivers.errors import DriverError, NotHomed, OutsideLimits
from drivers.stage.zaber import ZaberStage
from tests.unit.drivers.conftest import TurnedClock
from tests.unit.drivers.zaber_peer import SCALE, Controller, ZaberPeer, axes

AXES = st.sampled_from(["pan", "tilt"])
ANGLES = st.integers(-16 * SCALE, 16 * SCALE).map(lambda count: count / SCALE)


class Bench(RuleBasedStateMachine):
    """A stage in use, on controllers to which things happen."""

    @initialize(homed=st.booleans())
    def open(self, homed: bool) -> None:
        self.clock = TurnedClock()
        self.peer = ZaberPeer(self.clock)
        self.peer.spoil = self.spoil
        self.to_pass = self.to_lose = 0
        self.stage = ZaberStage(self.peer, axes(), clock=self.clock)
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

    def axis(self, name: str) -> Controller:
        return getattr(self.peer, name)

    def is_referenced(self) -> bool:
        return not any("WR" in axis.flags for axis in (self.peer.pan, self.peer.tilt))

    # ------------------------------------------------------------ what somebody does
    @rule()
    def home(self) -> None:
        self.ordered = len(self.peer.motions()) + 2
        try:
            self.stage.home()
        except DriverError:
            return
        assert self.is_referenced()
        assert (self.peer.pan.position(), self.peer.tilt.position()) == (0, 0)

    @rule(target_deg=st.dictionaries(AXES, ANGLES, min_size=1), lose=st.none() | st.integers(0, 8))
    def move(self, target_deg: dict[str, float], lose: int | None) -> None:
        if lose is not None:
            self.to_pass, self.to_lose = lose, 1
        referenced = all("WR" not in self.axis(name).flags for name in target_deg)
        before = len(self.peer.motions())
        self.ordered = before + len(target_deg)
        try:
            self.stage.move_to(target_deg)
        except (OutsideLimits, NotHomed):
            assert len(self.peer.motions()) == before
            return
        except DriverError:
            assert referenced or len(self.peer.motions()) == before
            return
        assert referenced
        for name, angle in target_deg.items():
            assert abs(angle) <= 15.0
            assert self.axis(name).position() == round(angle * SCALE)
            assert not self.axis(name).busy()

    @rule()
    def stop(self) -> None:
        try:
            self.stage.stop()
        except DriverError:
            return
        assert not self.peer.pan.busy()
        assert not self.peer.tilt.busy()

    @rule()
    def read(self) -> None:
        try:
            told = self.stage.position_deg()
        except DriverError:
            return
        for name, angle in told.items():
            assert self.axis(name).busy() or round(angle * SCALE) == self.axis(name).position()

    @rule()
    def begin_anew(self) -> None:
        """The program ends, and another opens the stage."""
        try:
            self.stage = ZaberStage(self.peer, axes(), clock=self.clock)
        except DriverError:
            self.to_pass = self.to_lose = 0
            self.stage = ZaberStage(self.peer, axes(), clock=self.clock)

    # ------------------------------------------------------------ what happens
    @rule(name=AXES)
    def restart(self, name: str) -> None:
        self.axis(name).restart()

    @rule(name=AXES, flag=st.sampled_from(["FS", "FE", "WL", "WM", "NI", "NC", "WT"]))
    def raise_flag(self, name: str, flag: str) -> None:
        self.axis(name).flags.append(flag)

    @rule(first=st.integers(0, 15), count=st.integers(1, 12))
    def lose_replies(self, first: int, count: int) -> None:
        self.to_pass, self.to_lose = first, count

    @rule(name=AXES)
    def somebody_turns_the_knob(self, name: str) -> None:
        self.axis(name).go(self.axis(name).position() + 500.0)

    @rule(seconds=st.floats(0.0, 5.0))
    def wait(self, seconds: float) -> None:
        self.clock.sleep(seconds)

    @precondition(lambda self: hasattr(self, "peer"))
    @invariant()
    def only_what_was_ordered_has_been_sent(self) -> None:
        assert len(self.peer.motions()) <= self.ordered


Bench.TestCase.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)
TestBench = Bench.TestCase
