"""Many different runs from one run of the simulated bench, in little time and on little disk.

A recording is varied by losing some events of its vectors at random (VECT_12 and VECT_8 words of EVT3), so that the
same stars are found at slightly other places. Runs share recordings, but no two runs have the same ones.
"""

import hashlib
import itertools
import os
import shutil
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from bench.record.journal import read_journal
from bench.record.run_folder import JOURNAL
from bench.record.unsynced_journal import UnsyncedJournal

_VECT_12, _VECT_8 = 0x4, 0x5
_KEPT = 0.97


def vary_recording(source: Path, target: Path, seed: int) -> None:
    """Write a recording that lacks three of a hundred events of its vectors."""
    data = source.read_bytes()
    begin = 0
    while data[begin : begin + 2] == b"% ":
        begin = data.index(b"\n", begin) + 1
    words = np.frombuffer(data, "<u2", offset=begin).copy()
    rng = np.random.default_rng(seed)
    for kind, bits in ((_VECT_12, 12), (_VECT_8, 8)):
        at = np.flatnonzero(words >> 12 == kind)
        kept = (rng.random((len(at), bits)) < _KEPT) @ (1 << np.arange(bits))
        words[at] &= (kept | kind << 12).astype("<u2")
    target.write_bytes(data[:begin] + words.tobytes())


def make_runs(base: Path, folder: Path, count: int) -> list[Path]:
    """Make ``count`` runs in ``folder`` from the run ``base``; each has one variation of each of its recordings."""
    entries, _ = read_journal(base / JOURNAL)
    captures = [str(entry.data["capture"]) for entry in entries if entry.event == "capture_stored"]
    each = next(n for n in range(1, count + 1) if n ** len(captures) >= count)
    pool = folder.parent / f"{folder.name}-recordings"
    for capture, number in itertools.product(captures, range(each)):
        varied = pool / str(number) / capture
        varied.parent.mkdir(parents=True, exist_ok=True)
        vary_recording(base / capture, varied, seed=number * len(captures) + captures.index(capture))
    hashes = {path: hashlib.sha256(path.read_bytes()).hexdigest() for path in pool.rglob("*.raw")}
    runs = []
    choices = itertools.islice(itertools.product(range(each), repeat=len(captures)), count)
    for number, chosen in enumerate(choices, 1):
        recordings = {name: pool / str(n) / name for name, n in zip(captures, chosen, strict=True)}
        run = folder / f"run-{number:04d}"
        run.mkdir(parents=True)
        for file in base.iterdir():
            if file.suffix in {".yaml", ".json"}:
                shutil.copy(file, run / file.name)
        for name, path in recordings.items():
            (run / name).parent.mkdir(exist_ok=True)
            os.link(path, run / name)
        _write_journal(run, entries, {name: hashes[path] for name, path in recordings.items()})
        runs.append(run)
    return runs


def _write_journal(run: Path, entries: Sequence, hashes: dict[str, str]) -> None:
    """Write the journal of the base run with the name and the recordings of another."""
    written = run / JOURNAL
    moments = iter(datetime.fromisoformat(entry.utc) for entry in entries)
    seconds = iter(entry.mono_s for entry in entries)
    with UnsyncedJournal.create(
        written, SimpleNamespace(utc_now=lambda: next(moments), monotonic=lambda: next(seconds))
    ) as journal:
        for entry in entries:
            data = dict(entry.data)
            if entry.event == "run_started":
                data["id"] = run.name
            if entry.event == "capture_stored":
                data["sha256"] = hashes[data["capture"]]
            journal.append(entry.event, **data)
