"""The plan of a batch uses how long the last runs took on this computer, and says why it is long."""

import json
from datetime import UTC, datetime, timedelta

import pytest

from bench.batch.batch_plan import Pace, paces, plan_batch, planned_duration_s
from bench.records.events import Event
from bench.records.journal import Journal
from bench.records.ledger_breaks import LedgerRun
from sequences.queue import JobConfig, Queue

BEGUN = datetime(2026, 3, 1, 20, tzinfo=UTC)


def ran(folder, took_s, *events, planned_s=100.0, how="finished", station="Simulated bench"):
    folder.mkdir()
    now = [BEGUN]
    (folder / "plan.json").write_text(json.dumps({"duration_s": planned_s}))
    with Journal.create(folder / "journal.jsonl", utc_now=lambda: now[0], monotonic=lambda: 0.0) as journal:
        journal.append(Event.RUN_STARTED, id=folder.name, station=station)
        for event in events:
            journal.append(event, what="Held by ada for 900 s before step 3.")
        now[0] += timedelta(seconds=took_s)
        journal.append(Event.RUN_ENDED, how=how, why="")
    return LedgerRun(1, folder.name, str(folder), "1", simulated=True, begun_utc=BEGUN.isoformat(), how=how)


def test_the_pace_is_the_median_of_runs_that_nothing_stopped(tmp_path):
    runs = [
        ran(tmp_path / "a", 240.0),
        ran(tmp_path / "b", 260.0),
        ran(tmp_path / "c", 250.0),
        ran(tmp_path / "held", 2000.0, Event.DEVIATION),
        ran(tmp_path / "resumed", 9000.0, Event.RUN_RESUMED),
        ran(tmp_path / "failed", 5.0, how="failed"),
        ran(tmp_path / "quick", 50.0, station="Quick"),
    ]
    runs.append(
        LedgerRun(9, "gone", str(tmp_path / "gone"), "1", simulated=True, begun_utc="", how="finished")
    )
    assert paces(runs) == {
        "Simulated bench": Pace(2.5, 3, "Simulated bench"),
        "Quick": Pace(1.0, 1, "Quick"),
        "": Pace(2.45, 4),
    }


@pytest.mark.parametrize("station", ["Simulated bench", ""])
@pytest.mark.parametrize("factor", [1.0, 1.9, 2.5])
def test_the_forecast_has_this_pace_and_says_why_from_twice_on(factor, station):
    job = JobConfig(name="a", sequence="three_pose", station="simulated")
    queue = Queue(format="starbench/queue/1", name="n", jobs=[job])
    night = plan_batch(queue, BEGUN, {station: Pace(factor, 7, station)})
    (slot,) = night.slots
    assert slot.end_s - slot.begin_s == pytest.approx(factor * planned_duration_s(job))
    place = f"On station {station}" if station else "On this computer"
    told = [text.startswith(f"{place}, the last 7 runs took 2.5 times") for text in night.slow]
    assert told == ([True] if factor > 2 else [])
