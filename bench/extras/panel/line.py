"""The line: one camera after the other, each begun by the text of a scanner, with PASS or FAIL at its end.

A run is a process of its own (`starbench run --expect-serial`), which goes on if the panel ends. This uses no device.
"""

from __future__ import annotations

import re
import subprocess
import sys
import threading
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NotRequired, TypedDict

from bench.base.errors import BenchError, ScriptError, UsageError
from bench.plan.plan import load_documents, make_plan
from bench.record.storage import make_folder, read_json, storage_errors
from bench.run.control import Command, send
from bench.run.launch import serial_number
from bench.run.status import read_status
from bench.wording.causes import cause_sentences
from bench.wording.conformity import conformity_headline, conformity_sentences

_WORDS = {0: ("pass", "PASS"), 3: ("stopped", "STOPPED"), 4: ("fail", "FAIL")}
_WRONG = ("refused", "WRONG CAMERA")
_BROKEN = ("broken", "NOT MEASURED")
_IN_DOUBT = ("doubt", "CHECK")
"""The limits are kept, and something was done to the bench that may have changed the values."""


class LineRun(TypedDict):
    """What the page of the line shows of the run; ``run`` names its own page, ``left_s`` is there while it goes on."""

    phase: str
    word: str
    serial: str
    lines: Sequence[str]
    run: str
    left_s: NotRequired[float | None]


class LineState(LineRun):
    """What the page of the line shows."""

    simulated: bool


class Line:
    """The line of a panel: at most one run at a time; station or sequence must state limits, for PASS or FAIL."""

    def __init__(self, root: Path, sequence: str, station: str, operator: str) -> None:
        self._root, self._sequence, self._station, self._operator = root, sequence, station, operator
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._serial, self._folder = "", root
        plan = make_plan(*load_documents(sequence, station))
        if plan.faults:
            raise ScriptError([str(fault) for fault in plan.faults])
        if not (plan.sequence.value.limits or plan.station.value.limits):
            raise UsageError(
                "A line needs limits: without them, no run says PASS or FAIL.",
                where=station,
                remedy="Add limits to the station or to the sequence.",
            )
        self._simulated = plan.station.value.is_simulated

    def begin(self, scanned: str) -> None:
        """Begin the run of the camera that was scanned. Raises UsageError if that cannot be."""
        serial = serial_number(scanned)
        with self._lock:
            if self._process is not None and self._process.poll() is None:
                raise UsageError(
                    f"Camera {self._serial} is being measured.", remedy="Wait for its end, or press STOP."
                )
            make_folder(self._root)
            name = f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{re.sub(r'[^A-Za-z0-9-]', '_', serial)}"
            self._serial, self._folder = serial, self._root / name
            words = ["run", self._sequence, "--station", self._station, "--output", str(self._folder)]
            words += ["--operator", self._operator, f"--expect-serial={serial}", "--json"]
            with storage_errors(self._root), self._said.open("wb") as output, self._log.open("wb") as log:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "bench", *words],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=log,
                    start_new_session=True,
                )

    def stop(self, known_by: str) -> None:
        """Ask the run to end safely. Raises BenchError if it does not answer."""
        command = Command.model_validate({"word": "abort", "by": self._operator, "known_by": known_by})
        send(self._folder, command)

    def state(self) -> LineState:
        """Return what the page shows."""
        return {**self._now(), "simulated": self._simulated}

    def _now(self) -> LineRun:
        with self._lock:
            process, serial, folder = self._process, self._serial, self._folder
        if process is None:
            return _state("ready", "READY", "", ["Scan the camera, then press START."], "")
        key = folder.name if folder.is_dir() else ""
        status = process.poll()
        if status is not None:
            return self._ended(status, serial, key)
        try:
            now = read_status(folder)
        except BenchError:  # it has not begun its journal
            return _state("running", "MEASURING", serial, ["starting"], key)
        if now.ended:  # the word follows when its process has ended, which takes a moment
            return _state("running", "MEASURING", serial, ["ending"], key)
        asks = [f"Asks: {now.question}"] if now.question else []
        lines = [*asks, f"{now.state}, {now.accepted} of {now.poses} poses"]
        return {**_state("running", "MEASURING", serial, lines, key), "left_s": now.left_s}

    def _ended(self, status: int, serial: str, key: str) -> LineRun:
        try:
            outcome = read_json(self._said)
        except (BenchError, ValueError):
            outcome = {}
        phase, word = _WORDS.get(status, _BROKEN)
        error, results = outcome.get("error") or {}, outcome.get("results") or {}
        lines = [error.get("what") or outcome.get("why") or f"See {self._log}."]
        if error.get("kind") == "WrongDevice":
            phase, word = _WRONG
        if conformity := results.get("conformity"):
            causes = cause_sentences(results.get("causes", ()))
            lines = [*causes, conformity_headline(conformity), *conformity_sentences(conformity)]
            if causes and phase == "pass":
                phase, word = _IN_DOUBT
        unsafe = [f"CHECK THE BENCH: {device}" for device in outcome.get("unsafe") or ()]
        if not outcome:  # it was killed: nothing is known of the devices
            unsafe = ["CHECK THE BENCH: the process of the run died. The light may be on."]
        return _state(phase, word, serial, [*unsafe, *lines], key)

    @property
    def _said(self) -> Path:
        return self._folder.with_suffix(".json")

    @property
    def _log(self) -> Path:
        return self._folder.with_suffix(".log")


def _state(phase: str, word: str, serial: str, lines: list[str], key: str) -> LineRun:
    return {"phase": phase, "word": word, "serial": serial, "lines": lines, "run": key}
