"""Which earlier run a run is compared with."""

from types import SimpleNamespace

import pytest

from bench.record.history import History
from bench.solve import earlier_runs

RUNS = [  # The last first: id, sequence, station, converged
    ("another-bench", "Three poses", "Practice", True),
    ("another-sequence", "Nine poses", "Bench 1", True),
    ("without-result", "Three poses", "Bench 1", False),
    ("right", "Three poses", "Bench 1", True),
    ("older", "Three poses", "Bench 1", True),
]


@pytest.fixture
def ledger(monkeypatch):
    results = {
        name: {
            "run": {"id": name, "sequence": sequence, "station": station},
            "calibration": {"converged": ok},
        }
        for name, sequence, station, ok in RUNS
    }
    lines = [SimpleNamespace(folder=name, seal="s") for name in results]
    monkeypatch.setattr(earlier_runs, "earlier_runs", lambda *_: lines)
    monkeypatch.setattr(earlier_runs, "read_sealed", lambda folder, _seal: (results[folder.name], ""))
    return SimpleNamespace()


@pytest.mark.parametrize(("station", "compared"), [("Bench 1", "right"), ("Bench 2", None)])
def test_a_run_is_compared_with_the_last_of_its_sequence_on_its_own_bench(ledger, station, compared):
    begun = History(started={"sequence": "Three poses", "station": station}, ledger={"number": 7})
    last = earlier_runs.last_results(ledger, begun)
    assert (last and last["run"]["id"]) == compared
