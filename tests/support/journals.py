"""Run folders with made-up journals, for pages that read them: any number of poses, any end, any damage."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from quick_runs import write_queue

from bench.base.clock import BenchClock, VirtualClock
from bench.record.folder_lock import lock_folder
from bench.record.journal import Journal
from bench.record.journal_line import FIRST_PREV, decode_line, encode_line
from bench.record.run_log import RunLog
from bench.run.control import CommandInbox

BEGIN = datetime(2026, 3, 1, 20, tzinfo=UTC)
CLOCK = VirtualClock(datetime(2026, 3, 1, tzinfo=UTC))
"""Of journals in which no time passes."""
GATES = [
    {"name": "stars", "value": 200, "unit": "", "limit": ">= 40", "verdict": "pass"},
    {"name": "event rate", "value": 90.0, "unit": "Mev/s", "limit": "<= 200", "verdict": "pass"},
]
GRID = [[30.0, 1.0, 20.0], [-1.0, 30.0, 10.0], [0.0, 0.0, 1.0]]


class MadeRun:
    """A run folder whose journal a test writes line by line.

    prompt: Whether a question comes before the calibration.
    """

    def __init__(self, folder: Path, poses: int = 3, *, prompt: bool = False) -> None:
        self.folder, self.poses = folder, poses
        self.path = folder / "journal.jsonl"
        self._now_s, self._seq, self._prev = 0.0, 0, FIRST_PREV
        (folder / "captures").mkdir(parents=True)
        (folder / "plan.json").write_text(json.dumps(_plan(poses, prompt)))
        self.path.touch()

    def line(self, event: str, **data: Any) -> bytes:
        """The next line, with its line feed, without writing it; 0.1 s after the one before."""
        self._now_s += 0.1
        moment = BEGIN + timedelta(seconds=self._now_s)
        line = encode_line(self._seq, moment, self._now_s, event, data, self._prev)
        self._prev, self._seq = decode_line(line, self._seq, self._prev).hash, self._seq + 1
        return line + b"\n"

    def write(self, event: str, **data: Any) -> None:
        """Append a line."""
        with self.path.open("ab") as stream:
            stream.write(self.line(event, **data))

    def enter(self, state: str, before: str, **more: Any) -> None:
        """Write that a state is entered."""
        with self.path.open("ab") as stream:
            stream.write(self._entering(state, before, **more))

    def _entering(self, state: str, before: str, **more: Any) -> bytes:
        return self.line("entering", state=state, **{"from": before}, **more)

    def begin(self, **more: Any) -> MadeRun:
        """Write what a run writes before its first pose, its first line with ``more``."""
        with self.path.open("ab") as stream:
            stream.writelines(self._first_lines(more))
        return self

    def record(self, pose: int, *, attempt: int = 1, accepted: bool = True, stars: int = 200) -> None:
        """Write what a run writes at one pose."""
        with self.path.open("ab") as stream:
            stream.writelines(self.pose_lines(pose, attempt, accepted, stars))

    def record_all(self) -> MadeRun:
        """Write all poses, quickly."""
        with self.path.open("ab") as stream:
            for pose in range(1, self.poses + 1):
                stream.writelines(self.pose_lines(pose, 1, True, 200))
        return self

    def end(self, how: str = "finished", why: str = "", **more: Any) -> MadeRun:
        """Write the end."""
        state = {"finished": "finished", "aborted": "aborted", "failed": "failed"}[how]
        self.enter(state, "checking")
        self.write("run_ended", how=how, why=why, **more)
        return self

    def _first_lines(self, more: dict[str, Any]) -> Iterator[bytes]:
        yield self.line(
            "run_started", id=self.folder.name, sequence="Made up", station="Bench", sha256={}, seed=1, operator="Ada",
            simulated=True, software={}, **more,
        )  # fmt: skip
        yield self._entering("preflight", "idle")
        camera = {"maker": "M", "model": "EVK4", "serial": "42", "width": 640, "height": 360}
        yield self.line("devices", camera=camera, stage=[], light={}, camera_settings={})
        yield self.line("left_off", state="preflight")

    def pose_lines(self, pose: int, attempt: int, accepted: bool, stars: int) -> Iterator[bytes]:
        step, name, at = 2 * pose, f"pose {pose}", {"pose": pose, "pose_name": f"pose {pose}"}
        if attempt == 1:
            angles = {"pan": 0.01 * pose, "tilt": -0.01 * pose}
            yield self._entering("slewing", "checking", step=step - 1, target_deg=angles, **at)
            yield self.line("left_off", state="slewing")
            yield self.line("step_done", step=step - 1)
        yield self._entering("recording", "slewing", step=step, attempt=attempt, **at)
        capture = f"captures/pose-{pose:03d}-attempt-{attempt}.raw"
        degrees = {"pan": 0.01 * pose, "tilt": -0.01 * pose}
        facts = {"width": 640, "height": 360, "events": 4_000_000, "duration_s": 0.05, "temperature_c": 40.0}
        yield self.line(
            "capture_stored", capture=capture, size=9, sha256="0" * 64, pose=pose, pose_name=name, attempt=attempt,
            commanded_deg=degrees, measured_deg=degrees, measured_after_deg=degrees,
            light={"waveform": "square", "frequency_hz": 60.0}, facts=facts,
        )  # fmt: skip
        yield self._entering("checking", "recording", step=step, attempt=attempt, **at)
        gates = GATES if accepted else [{**GATES[0], "value": 3, "verdict": "fail"}, GATES[1]]
        yield self.line(
            "attempt_checked", pose=pose, attempt=attempt, accepted=accepted, stars=stars, gates=gates,
            reasons=[] if accepted else ["3 stars, at least 40 are needed"], measured={"grid": GRID, "flicker_hz": 60.0},
        )  # fmt: skip
        if accepted:
            yield self.line("step_done", step=step)


def _plan(poses: int, prompt: bool) -> dict[str, Any]:
    kinds = [(kind, pose) for pose in range(1, poses + 1) for kind in ("move", "record")]
    steps, after_s = [], 1.0
    for number, (kind, pose) in enumerate(kinds, 1):
        after_s += 0.5
        step = {"number": number, "what": kind, "duration_s": 0.5, "done_after_s": after_s}
        steps.append(step | {"pose": pose})
    tail = [("prompt", 100.0)] if prompt else []
    for kind, duration_s in [*tail, ("solve", 1.0)]:
        after_s += duration_s
        number = len(steps) + 1
        steps.append({"number": number, "what": kind, "duration_s": duration_s, "done_after_s": after_s})
    return {
        "schema": "starbench/plan/1",
        "simulated": True,
        "duration_s": after_s,
        "most_bytes": 1000,
        "poses": [
            {"index": n, "name": f"pose {n}", "angles_deg": {"pan": 0.01 * n, "tilt": -0.01 * n}}
            for n in range(1, poses + 1)
        ],
        "steps": steps,
    }


@contextmanager
def at_work(run: MadeRun) -> Iterator[tuple[RunLog, BenchClock]]:
    """A process at work on a run: its lock and its inbox, and a journal that continues the made one."""
    lock = lock_folder(run.folder)
    clock = BenchClock()
    try:
        with Journal.open(run.path, clock) as journal:
            log = RunLog(journal)
            poses = {n: f"pose {n}" for n in range(1, run.poses + 1)}
            with CommandInbox(run.folder, log, poses, clock):
                yield log, clock
    finally:
        os.close(lock)


def made_batch(folder: Path, *, jobs: tuple[str, ...] = ("cam",)) -> MadeRun:
    """A batch folder with a queue and a journal that has begun; each job is one run."""
    batch = MadeRun(folder)
    lines = [f"name: {name}, sequence: three_pose, station: simulated" for name in jobs]
    write_queue(folder / "queue.yaml", *lines)
    batch.write("batch_begun", queue="Night", files={})
    return batch
