"""A run driven by random faults, commands, crashes and doors, against a small model of what may come of it.

The run is the real one (machine, journal, inbox, interlocks) on virtual devices and a virtual clock. A crash is an
exception that nothing of ours catches; what follows is a resume. The model knows three things of each pose: to do,
recorded, left out; and that the bench is dark and at rest whenever no process works on the run.
"""

from uuid import uuid4

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    precondition,
    rule,
    run_state_machine_as_test,
)
from quick_runs import THREE
from rehearsed import Scene, with_runner
from run_faults import Died, command, mortal

from bench.base.clock import VirtualClock
from bench.record.events import Event
from bench.record.history import replay
from bench.record.journal import read_journal, stored_captures
from bench.record.storage import sha256_of
from bench.run.machine import EDGES
from drivers.errors import (
    CameraLost,
    LightFault,
    MoveFailed,
    NotHomed,
    PortLost,
    RecordingFailed,
    ReplyTimeout,
    SettingRefused,
)

POSES = 3
PLACES = (
    "open",
    "stage.identify",
    "light.identify",
    "camera.identify",
    "stage.home",
    "light.apply",
    "light.on",
    "light.off",
    "light.read",
    "stage.move_to",
    "stage.position_deg",
    "camera.record",
    "stage.stop",
    "camera.stop",
)
"""Everything that may go wrong, go away, or be happening when something else happens."""
FAULTS = (
    PortLost("gone"),
    CameraLost("gone"),
    ReplyTimeout("silent"),
    RecordingFailed("broke off"),
    MoveFailed("stalled"),
    NotHomed("no reference"),
    SettingRefused("clipped"),
    LightFault("lamp open"),
)
ENDS: list[str] = []
"""How each process ended."""
TAKEN: set[tuple[str, str]] = set()
"""Edges (state left, state entered) that any run of these tests has taken."""


PLACE = st.tuples(st.sampled_from(PLACES), st.integers(1, 3))
BEFALLS = st.one_of(
    st.tuples(st.just("fault"), PLACE, st.sampled_from(FAULTS)),
    st.tuples(st.just("death"), PLACE, st.none()),
    st.tuples(st.just("door"), PLACE, st.sampled_from([1, 30, 100])),
    st.tuples(st.just("command"), PLACE, st.sampled_from(["hold", "abort", "skip"])),
    st.tuples(st.just("skip"), PLACE, st.integers(1, POSES)),
    st.tuples(st.just("signal"), PLACE, st.none()),
)
"""What befalls a process, at which call of what."""


class Life(RuleBasedStateMachine):
    """The life of one run: processes that work on it, one after another, and what befalls each."""

    folder = None

    def __init__(self):
        super().__init__()
        self._patch = pytest.MonkeyPatch()
        self.recorded: dict[int, str] = {}
        self.skipped: set[int] = set()
        self.ended = ""
        self.light_failed = False
        self.shut_at_s = None
        self.processes = 0

    def teardown(self):
        self._patch.undo()

    @initialize(guarded=st.booleans())
    def a_run_is_begun(self, guarded):
        self.begin(guarded)

    def begin(self, guarded):
        folder = self.folder / uuid4().hex
        folder.mkdir()
        self.door = folder / "door"
        self.door.write_text("1")
        words = f"\ninterlocks: {{door: {{path: {self.door}, max_hold_s: 60}}, "
        words += "device_lost: {retry_s: 5, max_hold_s: 60}}\n"
        self.scene = with_runner(Scene(folder, station=words if guarded else "", poses=THREE), self._patch)

    @precondition(lambda self: self.ended == "finished")
    @rule(guarded=st.booleans())
    def another_run_is_begun(self, guarded):
        self._patch.undo()
        self.recorded, self.skipped, self.ended = {}, set(), ""
        self.begin(guarded)

    @precondition(lambda self: self.ended != "finished")
    @rule(befalls=st.lists(BEFALLS, min_size=1, max_size=4))
    def a_process_works_on_it(self, befalls):
        counts: dict[str, int] = {}
        self.scene.dead = self.light_failed = False
        self.shut_at_s = None

        def hook(name):
            self._see_whether_dead()
            counts[name] = counts.get(name, 0) + 1
            for kind, (place, nth), what in befalls:
                if (place, nth) == (name, counts[name]):
                    self._befall(kind, what, name)
            if self.scene.runner is not None:
                self.scene.runner.context.interlocks.check_door()

        self.scene.hook, self.scene.runner = hook, None
        self.processes += 1
        self._begin_s = self.scene.clock.utc_now()
        with pytest.MonkeyPatch.context() as patch:
            self._let_time_shut_doors_and_end_holds(patch)
            try:
                self.ended = self.scene.run(journal_type=mortal(self.scene)).how
            except Died:
                self.ended = ""
        self.door.write_text("1")
        ENDS.append("died" if self.scene.dead else self.ended)
        self._compare()

    def _befall(self, kind, what, name):
        match kind:
            case "fault":
                # A process that cannot open the devices cannot switch off what a dead process left on.
                self.light_failed |= name in {"light.off", "open"}
                raise what
            case "death":
                self.scene.dead = True
                self._see_whether_dead()
            case "door":
                self._open_door(what)
            case "command":
                command(self.scene, what)
            case "skip":
                command(self.scene, "skip", pose=what)
            case "signal":
                self.scene.clock.request_stop("SIGTERM received")

    def _see_whether_dead(self):
        if self.scene.dead:
            raise Died

    def _let_time_shut_doors_and_end_holds(self, patch):
        """A hold ends after a while, a door is shut after its time."""
        sleep, life = VirtualClock.sleep, self

        def passing(clock, seconds):
            if life.shut_at_s is not None and clock.monotonic() >= life.shut_at_s:
                life.door.write_text("1")
                life.shut_at_s = None
            runner = life.scene.runner
            if runner is not None and runner.context.log.history.holder and runner.state == "holding":
                command(life.scene, "release")
            sleep(clock, seconds)

        patch.setattr(VirtualClock, "sleep", passing)

    def _open_door(self, shut_after_s):
        self.door.write_text("0")
        self.shut_at_s = self.scene.clock.monotonic() + shut_after_s

    # ------------------------------------------------------------ what must hold whatever happened

    def _compare(self):
        entries, torn = read_journal(self.scene.folder / "journal.jsonl")
        assert torn == b""
        history = replay(entries)
        accepted = {pose: a.stored["sha256"] for pose, a in history.accepted().items()}
        assert self.recorded.items() <= accepted.items()  # what was recorded once is recorded for ever
        checked = [e.data for e in entries if e.event == Event.ATTEMPT_CHECKED]
        assert len(accepted) == sum(check["accepted"] for check in checked)  # and never twice
        assert not set(accepted) & set(history.skipped)
        assert self.skipped <= set(history.skipped)
        self.recorded, self.skipped = accepted, set(history.skipped)
        for capture in stored_captures(entries).values():
            assert sha256_of(self.scene.folder / capture.name) == capture.sha256
        for _, data in self.scene.events():
            if "state" in data and "from" in data:
                assert (data["from"], data["state"]) in ALLOWED
                TAKEN.add((data["from"], data["state"]))
        if self.ended:
            assert entries[-1].event == Event.RUN_ENDED
            assert entries[-1].data["how"] == self.ended
            assert not (self.scene.folder / "control").exists()
            assert not self.scene.light_is_on() or self.light_failed
        if self.ended == "finished":
            assert set(accepted) | self.skipped == set(range(1, POSES + 1))
        assert (self.scene.clock.utc_now() - self._begin_s).total_seconds() < 1800


ALLOWED = {(source, target) for _, sources, target in EDGES for source in sources}


@pytest.fixture(scope="module", autouse=True)
def _one_folder_for_all(tmp_path_factory):
    Life.folder = tmp_path_factory.mktemp("lives")


RANDOM_RUNS = settings(
    max_examples=15,
    derandomize=True,  # so that these runs end in every way today and tomorrow
    stateful_step_count=8,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)


def test_random_runs_keep_their_promises_and_end_in_every_way():
    run_state_machine_as_test(Life, settings=RANDOM_RUNS)
    assert {"finished", "aborted", "failed", "died"} <= set(ENDS)
    assert {("holding", "lighting"), ("recovering", "preflight")} <= TAKEN
    assert {("slewing", "holding"), ("settling", "holding"), ("recording", "holding")} & TAKEN
