"""A bench with a key, a ledger and one sealed run, whose numbers are those of a real simulated run."""

import functools
import json
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

from unchecked_seal import seal_unchecked

from bench.base.bounded_json import canonical_json
from bench.base.clock import VirtualClock
from bench.evidence.keys import ensure_key
from bench.record.journal import Journal
from bench.record.ledger import Ledger
from bench.record.stored_run import results_of

RESULTS = Path(__file__).with_name("certificate_results.json")
"""results.json of `make demo`, without the truth and the planar model, as of the day of the sample."""
NOW = datetime(2026, 11, 21, 8, 30, tzinfo=UTC)


@functools.cache
def sample_results():
    """The results that the full sample is made of."""
    return results_of(RESULTS.read_bytes(), RESULTS)


def write_sealed_run(folder, home, *, how="finished", rehearsal=False, results=None):
    """A sealed folder with the journal and the results of a run: what a certificate reads of one."""
    folder.mkdir(parents=True)
    with Journal.create(folder / "journal.jsonl", VirtualClock(NOW)) as journal:
        journal.append("run_started", id="run", simulated=True, **({"rehearsal": True} if rehearsal else {}))
        journal.append("run_ended", how=how, why="")
    stored = canonical_json(json.loads(RESULTS.read_bytes()) if results is None else results)
    (folder / "results.json").write_bytes(stored)
    seal_unchecked(folder, ensure_key(home, principal="bench@lab"))
    return folder


class SealedBench:
    """A bench in a folder of its own, whose clock is set by hand."""

    def __init__(self, path):
        self.path, self.now = path, NOW
        self.home = path / "home"
        self.run = write_sealed_run(path / "run", self.home)
        self.ledger = Ledger(self.home, SimpleNamespace(utc_now=lambda: self.now, monotonic=lambda: 0.0))
        place = self.ledger.begin(run_id="run", folder=self.run, camera="00050423", simulated=True)
        self.ledger.end(place["number"], how="finished", folder=self.run)
