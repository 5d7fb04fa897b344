"""A bench with virtual devices on a virtual clock, in a folder of its own: its runs take a second."""

import io
import os
from datetime import UTC, datetime
from unittest import mock

from quick_runs import THREE, write_sequence, write_station

from bench.base.clock import VirtualClock
from bench.batch.rehearsal import RehearsedJob, RehearsedResults
from bench.batch.virtual_devices import VirtualDevices
from bench.evidence.key_trust import read_trust
from bench.evidence.keys import ensure_key
from bench.evidence.ledger_check import sealed_strangers
from bench.evidence.verify import verify_folder
from bench.plan.job import Job
from bench.record.journal import CAPTURE_STORED, read_journal
from bench.record.ledger import Ledger
from bench.run.launch import Launch, resume_run, start_run

BEGIN = datetime(2026, 3, 1, 20, tzinfo=UTC)


class Wired(VirtualDevices):
    """Virtual devices whose every order to the stage and the light goes into the wire log, as those of links do."""

    def __init__(self, station, *, seed, clock, wire_log):
        super().__init__(station, seed=seed, clock=clock)
        for device, name in ((self.stage, "move_to"), (self.light, "on"), (self.light, "off")):
            self._wire(device, name, clock, wire_log)

    def _wire(self, device, name, clock, wire_log):
        real = getattr(device, name)

        def call(*args, **more):
            wire_log.record(clock.monotonic(), "port", ">", name.encode())
            return real(*args, **more)

        setattr(device, name, call)


class VirtualBench:
    """A bench with virtual devices in a folder of its own; a run is begun by one command, and continued by another."""

    def __init__(self, folder):
        self.folder, self.home, self.run = folder, folder / "home", folder / "run"
        folder.mkdir()
        ensure_key(self.home, principal="bench@lab")
        self.sequence = write_sequence(folder / "sequence.yaml", THREE, attempts=1)
        self.station = write_station(folder / "station.yaml")
        self.clock = VirtualClock(BEGIN)

    def _virtual(self):
        plain, clock = Job.from_plan, self.clock

        def from_plan(*words, **more):
            job = plain(*words, **more)
            return RehearsedJob(job.plan, job.steps, job.seed, job.operator, clock)

        return (
            mock.patch.object(Job, "from_plan", from_plan),
            mock.patch("bench.run.launch.Devices", Wired),
            mock.patch("bench.run.runner.ResultWriter", RehearsedResults),
            mock.patch("bench.evidence.seal.check_content"),  # which refuses such results
            mock.patch.dict(os.environ, {"STARBENCH_HOME": str(self.home)}),
        )

    def begin(self):
        job, devices, results, seal, home = self._virtual()
        with job, devices, results, seal, home:
            return start_run(
                str(self.sequence), str(self.station), output=self.run, seed=1, operator="Ada",
                launch=Launch(self.clock, stream=io.StringIO()),
            )  # fmt: skip

    def resume(self):
        self.clock = VirtualClock(self.clock.utc_now())
        job, devices, results, seal, home = self._virtual()
        with job, devices, results, seal, home:
            return resume_run(self.run, Launch(self.clock, stream=io.StringIO()))

    def entries(self):
        return read_journal(self.run / "journal.jsonl")[0] if (self.run / "journal.jsonl").exists() else []

    def stored(self):
        return [(e.data["capture"], e.data["sha256"]) for e in self.entries() if e.event == CAPTURE_STORED]

    def faults(self):
        """What the verifier finds. A report without pictures, which would take 20 s, is a fault of every such run."""
        return verify_folder(self.run, read_trust(self.home)).faults

    def ledger(self):
        return Ledger(self.home, self.clock)

    def finish(self):
        """Do what an operator does next: resume, or give the same command again."""
        if any(entry.event == "run_started" for entry in self.entries()):
            if not (self.run / "SHA256SUMS.sig").exists():
                assert self.resume().how == "finished"
        else:
            assert self.begin().how == "finished"

    def breaks(self):
        """What the ledger finds of itself and of the runs that are sealed."""
        ledger = self.ledger()
        return [*ledger.breaks(sealed_strangers(self.home))[0], *map(str, ledger.faults())]
