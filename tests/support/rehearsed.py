"""Runs in this process, on a virtual clock, on virtual devices that do as a test says; and what they leave."""

from datetime import UTC, datetime
from functools import partial

from quick_runs import write_sequence, write_station

import bench.batch.rehearsal
from bench.base.clock import VirtualClock
from bench.batch.rehearsal import RehearsedJob, rehearse_job
from bench.batch.virtual_devices import VirtualDevices
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.record.events import Event
from bench.record.history import replay
from bench.record.journal import read_journal
from bench.record.unsynced_journal import UnsyncedJournal
from bench.run.runner import Runner

BEGIN = datetime(2026, 3, 1, 20, tzinfo=UTC)
TWO = "[{pan_deg: -6, tilt_deg: 2}, {pan_deg: 6, tilt_deg: 2}]"


class Hooked:
    """A device whose every method first tells a test of it, which may raise, or change what comes of it."""

    def __init__(self, device, name, hook):
        self._device, self._name, self._hook = device, name, hook

    def __getattr__(self, attribute):
        value = getattr(self._device, attribute)
        return partial(self._call, value, f"{self._name}.{attribute}") if callable(value) else value

    def _call(self, method, name, *words, **more):
        change = self._hook(name)
        answer = method(*words, **more)
        return change(answer) if change is not None else answer


class Scene:
    """A station, a sequence and a hook: called with what is about to happen, as ``stage.move_to``."""

    def __init__(self, folder, *, station="", poses=TWO, end="", attempts=2, sequence=None, settings=None):
        self.folder = folder / "run"
        sequence = sequence or write_sequence(folder / "sequence.yaml", poses, attempts=attempts, end=end)
        planned = make_plan(
            *load_documents(str(sequence), str(write_station(folder / "station.yaml", station)), settings)
        )
        assert not planned.faults, [str(fault) for fault in planned.faults]
        self.task = Job.from_plan(planned, seed=1, operator=None)
        self.hook = lambda _name: None
        self.errors = {}
        """What calls raise, by their names."""
        self.opened = []
        self.calls = []
        self.runner = None
        self.dead, self.disk = False, lambda: None
        self.clock = VirtualClock(BEGIN)

    def run(self, *, journal_type=UnsyncedJournal):
        """Run, or go on; on a clock of its own, as a new process has."""
        task = self.task
        self.clock = VirtualClock(self.clock.utc_now())
        job = RehearsedJob(task.plan, task.steps, task.seed, task.operator, self.clock)
        return rehearse_job(job, self.folder, partial(self._open, job), journal_type)

    def _open(self, job):
        self._happens("open")
        devices = VirtualDevices(job.station, seed=1, clock=self.clock)
        if self.opened:  # what has power keeps its reference and its light
            devices.stage.at_deg = self.light_and_stage()[1].at_deg
            devices.light.lit = self.light_is_on()
        self.opened.append((devices.light, devices.stage))
        for name in ("stage", "light", "camera"):
            setattr(devices, name, Hooked(getattr(devices, name), name, self._happens))
        return devices

    def _happens(self, name):
        self.calls.append(name)
        if name in self.errors:
            raise self.errors[name]
        return self.hook(name)

    def at(self, call, nth, do):
        """Do something at the n-th call of a name, of all runs of this scene."""

        def hook(name):
            if name == call and self.calls.count(name) == nth:
                do()

        self.hook = hook

    def fail_at(self, call, nth, error):
        def fail():
            raise error

        self.at(call, nth, fail)

    def light_and_stage(self):
        return self.opened[-1]

    def light_is_on(self):
        """Asked of the light itself."""
        return bool(self.opened) and self.light_and_stage()[0].is_on()

    def events(self):
        return [(e.event, e.data) for e in read_journal(self.folder / "journal.jsonl")[0]]

    def history(self):
        """What the journal amounts to."""
        return replay(read_journal(self.folder / "journal.jsonl")[0])

    def data_of(self, event):
        return [data for name, data in self.events() if name == event]

    def states(self):
        return [data["state"] for data in self.data_of(Event.ENTERING)]


def with_runner(scene, monkeypatch):
    """Let a scene know the runner at work, for tests that play the thread of interlocks and commands."""

    class Known(Runner):
        def __init__(self, *words, **more):
            super().__init__(*words, **more)
            scene.runner = self

    monkeypatch.setattr(bench.batch.rehearsal, "Runner", Known)
    return scene
