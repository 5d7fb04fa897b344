"""Many finished runs on the disk in little time, with the ledgers of their benches; no sensor and no fit is simulated.

Each folder has a journal with a valid chain and the lines of a real run, and a results.json whose hash the journal
states. Values of the parameters come from the caller.
"""

import hashlib
import json
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

from bench.record.events import Event
from bench.record.ledger_marks import RUN_BEGUN, RUN_ENDED, LedgerMark, write_own_mark
from bench.record.unsynced_journal import UnsyncedJournal

BEGIN = datetime(2026, 1, 5, 8, 0, tzinfo=UTC)
SIGMAS = {"fx": 1.0, "fy": 1.0, "cx": 1.3, "cy": 2.7, "k1": 0.007, "k2": 0.16, "r": 0.08}
VALUES = {"fx": 3345.0, "fy": 3345.2, "cx": 642.1, "cy": 363.3, "k1": 0.06, "k2": -0.9, "r": 255.0}
AXES = (("pan", "1"), ("tilt", "2"))
SOFTWARE = {"starbench": "0.1.0", "python": "3.11.7", "numpy": "2.4.6"}


def results_of(folder, serial, target):
    run = {"laboratory": "Test laboratory", "collimator": {"serial": "C-1"}, "target": {"serial": target}}
    results = {
        "schema": "starbench/results/1",
        "run": run,
        "calibration": {"degrees_of_freedom": 1266, "notes": ["Views differ more than star noise explains."]},
        "passport": {"number": "SIM-2026-01"},
        "projection": {"worst_corner": {"expanded_px": 0.61}},
        "devices": {"camera": {"serial": serial}},
    }
    data = json.dumps(results).encode()
    (folder / "results.json").write_bytes(data)
    return hashlib.sha256(data).hexdigest()


def write_run(
    folder,
    *,
    begun=BEGIN,
    values=VALUES,
    sigmas=SIGMAS,
    serial="00050001",
    camera_model="EVK4",
    station="Bench 1",
    model="radial",
    temperature_c=41.5,
    simulated=False,
    rehearsal=False,
    place=None,
    target="T-1",
    ended="finished",
    poses=3,
    operator="ada",
    solved=(),
    deviations=(),
):
    """Write one run; ``values`` None is a run without a result, ``solved`` more of what is told of it."""
    folder.mkdir(parents=True)
    moments, seconds = iter(begun + timedelta(seconds=n) for n in range(10_000)), iter(range(10_000))
    with UnsyncedJournal.create(
        folder / "journal.jsonl",
        SimpleNamespace(utc_now=lambda: next(moments), monotonic=lambda: float(next(seconds))),
    ) as journal:
        journal.append(
            Event.RUN_STARTED, id=folder.name, sequence="Three poses", station=station,
            sha256={"sequence.yaml": "a" * 64, "station.yaml": "b" * 64, "passport.json": "c" * 64}, seed=1,
            operator=operator, simulated=simulated, software=SOFTWARE,
            **({"ledger": place} if place else {}), **({"rehearsal": True} if rehearsal else {}),
        )  # fmt: skip
        camera = {"maker": "Prophesee", "model": camera_model, "sensor": "IMX636", "serial": serial, "firmware": "4.2",
                  "width": 1280, "height": 720, "lens": "16 mm"}  # fmt: skip
        stage = [{"name": n, "maker": "Zaber", "model": "RST", "serial": s} for n, s in AXES]
        light = {"maker": "Keysight", "model": "33250A", "serial": "SG0042"}
        settings = {"biases": {"bias_fo": 0}, "trigger_in": True}
        journal.append(Event.DEVICES, camera=camera, stage=stage, light=light, camera_settings=settings)
        for pose in range(1, poses + 1):
            facts = {"illumination_lux": 90.3, "events": 3_800_000, "bytes": 1_460_000}
            if temperature_c is not None:
                facts["temperature_c"] = temperature_c + pose - (poses + 1) / 2
            journal.append(
                Event.CAPTURE_STORED, capture=f"captures/pose-{pose:03}-attempt-1.raw", size=1_460_000, sha256="d" * 64,
                pose=pose, pose_name=f"p{pose}", attempt=1, light={"frequency_hz": 60.0}, facts=facts,
            )  # fmt: skip
            journal.append(
                Event.ATTEMPT_CHECKED, pose=pose, attempt=1, accepted=True, reasons=[], stars=200, gates=[],
                measured={"flicker_hz": 60.0006},
            )  # fmt: skip
        for what in deviations:
            journal.append(Event.DEVIATION, what=what)
        if values:
            journal.append(
                Event.SOLVED, model=model, converged=True, rms_px=0.081, values=dict(values), sigma=dict(sigmas),
                coverage_factor=2.2, **dict(solved),
            )  # fmt: skip
            files = {"results.json": results_of(folder, serial, target)}
            journal.append(Event.WRITTEN, head="", files=files)
        if ended:
            journal.append(Event.RUN_ENDED, how=ended, why="")
    return folder


class BenchOfRuns:
    """A bench that enters runs in a ledger of its own; ``close`` writes the bench's own mark."""

    def __init__(self, home, runs, *, station="Bench 1", simulated=False):
        home.mkdir(parents=True)
        self.home, self.runs, self.station, self.simulated = home, runs, station, simulated
        self.moment, self.number = BEGIN, 0
        self.journal = UnsyncedJournal.create(
            home / "ledger.jsonl", SimpleNamespace(utc_now=lambda: self.moment, monotonic=self._seconds)
        )

    def _seconds(self):
        return self.moment.timestamp()

    def run(self, *, begun, serial="00050001", **facts):
        self.moment, self.number = begun, self.number + 1
        folder = self.runs / f"run-{self.number:05}"
        self.journal.append(
            RUN_BEGUN, number=self.number, run=folder.name, folder=str(folder), camera=serial, simulated=self.simulated
        )  # fmt: skip
        place = {"number": self.number, "head": self.journal.head, "of_camera": {}}
        stated = {"station": self.station, "simulated": self.simulated, **facts}
        write_run(folder, begun=begun, serial=serial, place=place, **stated)
        self.journal.append(RUN_ENDED, number=self.number, how=facts.get("ended", "finished"), seal=None)
        return folder

    def close(self):
        self.journal.close()
        entries = self.journal.entries
        mark = LedgerMark(len(entries), self.number, entries[-1].hash, entries[-1].utc)
        write_own_mark(self.home, mark)
        return self.home
