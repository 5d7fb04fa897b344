"""Which run of a batch comes next, and when: times of day, priorities, bounds, and how long runs take here."""

import json
from datetime import UTC, datetime, timedelta
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.batch.batch_plan import plan_batch, planned_duration_s
from bench.batch.batch_record import Bounds, Item, bounds_of, choose_next, items_of, look_ahead, next_time
from bench.record.events import Event
from bench.record.journal import Journal
from bench.record.ledger_marks import LedgerRun
from bench.record.pace import Pace, pace_on, paces
from sequences.queue import JobConfig, Queue

EVENING = datetime(2026, 3, 1, 18, 0, tzinfo=UTC)


def job(name="a", **words):
    return JobConfig(name=name, sequence="s", station="t", **words)


def queue(*jobs, **words):
    return Queue(
        format="starbench/queue/1", name="n", jobs=list(jobs) or [job()], zone="Europe/Berlin", **words
    )


@pytest.mark.parametrize(
    ("after", "at", "expected"),
    [
        ("2026-03-01T18:00", "19:30", "2026-03-01T18:30"),  # 19:30 in Berlin is 18:30 UTC
        ("2026-03-01T18:30", "19:30", "2026-03-02T18:30"),  # strictly after
        ("2026-03-01T23:30", "00:15", "2026-03-02T23:15"),  # already the next day in Berlin
        ("2026-03-28T12:00", "02:30", "2026-03-29T01:30"),  # not that night: an hour later by the sun
        ("2026-10-24T12:00", "02:30", "2026-10-25T00:30"),  # comes twice that night: the first
        ("2026-10-25T00:30", "02:30", "2026-10-25T01:30"),  # and the second
        ("2026-10-25T01:30", "02:30", "2026-10-26T01:30"),
    ],
)
def test_a_time_of_day_is_its_next_occurrence_on_the_clocks_of_its_zone(after, at, expected):
    after, expected = (datetime.fromisoformat(text).replace(tzinfo=UTC) for text in (after, expected))
    assert next_time(at, after, "Europe/Berlin") == expected


def test_a_batch_waits_for_its_start_and_stops_by_the_morning_after():
    bounds = bounds_of(queue(start_at="21:00", stop_by="06:30", stop_after_h=8), EVENING)
    times_h = [at_s / 3600 for at_s in (bounds.opens_s, bounds.last_begin_s, bounds.done_by_s)]
    assert times_h == [2, 10, 11.5]


def test_repetitions_count_from_the_start_and_a_jobs_own_time_moves_all_of_its():
    items = items_of(
        [job(times=2, every_min=30), job("b", start_at="21:15", times=2)], EVENING, 7200, "Europe/Berlin"
    )
    assert [(item.key, item.due_s) for item in items] == [
        ("a-001", 7200), ("a-002", 9000), ("b-001", 8100), ("b-002", 8100),
    ]  # fmt: skip


def test_a_job_at_the_very_moment_of_the_start_does_not_wait_a_day():
    (item,) = items_of([job(start_at="21:00")], EVENING, 7200, "Europe/Berlin")
    assert item.due_s == pytest.approx(7200, abs=1e-3)


def test_a_run_may_last_beyond_the_last_begin_but_not_begin_after_it():
    bounds = Bounds(last_begin_s=100)
    (item,) = items_of([job()], EVENING)
    assert choose_next([item], 100, bounds, lambda _: 1e6) is item
    assert choose_next([item], 100.1, bounds, lambda _: 1) is None


jobs_drawn = st.lists(
    st.builds(
        job,
        name=st.sampled_from([f"j{n}" for n in range(8)]),
        times=st.integers(1, 4),
        every_min=st.sampled_from([0.0, 1.0, 7.5, 60.0]),
        priority=st.integers(-2, 2),
    ),
    min_size=1,
    max_size=5,
    unique_by=lambda drawn: drawn.name,
)


@given(
    jobs_drawn,
    st.sampled_from([30.0, 700.0]),
    st.sampled_from([0.0, 1000.0]),
    st.sampled_from([3000.0, 20000.0]),
)
def test_the_look_ahead_is_what_a_batch_does_that_takes_as_long_as_expected(
    jobs, expected_duration_s, opens_s, done_by_s
):
    """Drive the rule step by step, as the batch does, in many small waits; the look ahead must say the same."""
    bounds = Bounds(opens_s=opens_s, done_by_s=done_by_s)
    items = items_of(jobs, EVENING, opens_s)
    undone, at_s, begun = list(items), 0.0, []
    while (choice := choose_next(undone, at_s, bounds, lambda _: expected_duration_s)) is not None:
        if isinstance(choice, Item):
            begun.append((choice.key, at_s))
            undone.remove(choice)
            at_s += expected_duration_s
        else:
            at_s += min(choice, 97.0)
    slots = look_ahead(items, 0.0, bounds, lambda _: expected_duration_s)
    assert [slot.item.key for slot in slots if slot.begin_s is not None] == [key for key, _ in begun]
    assert [slot.begin_s for slot in slots if slot.begin_s is not None] == pytest.approx(
        [s for _, s in begun]
    )
    assert {slot.item.key for slot in slots if slot.begin_s is None} == {item.key for item in undone}
    for slot in slots:
        if slot.begin_s is not None:
            assert slot.begin_s >= max(slot.item.due_s, opens_s) - 1e-6
            assert slot.end_s <= done_by_s
    ends = [slot.end_s for slot in slots if slot.end_s is not None]
    begins = [slot.begin_s for slot in slots if slot.begin_s is not None]
    assert all(begin >= end - 1e-6 for begin, end in zip(begins[1:], ends, strict=False))  # one at a time


# ---------------------------------------------------------------- how long the last runs took

BEGUN = datetime(2026, 3, 1, 20, tzinfo=UTC)


def ran(folder, took_s, *events, planned_s=100.0, how="finished", station="Simulated bench"):
    folder.mkdir()
    now = [BEGUN]
    (folder / "plan.json").write_text(json.dumps({"duration_s": planned_s}))
    with Journal.create(
        folder / "journal.jsonl", SimpleNamespace(utc_now=lambda: now[0], monotonic=lambda: 0.0)
    ) as journal:
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


def test_one_run_is_expected_to_take_as_long_as_the_latest_runs_of_its_station_else_of_the_bench(
    tmp_path, monkeypatch
):
    runs = [ran(tmp_path / "a", 250.0), ran(tmp_path / "b", 50.0, station="Quick")]
    monkeypatch.setattr("bench.record.pace.runs_of_bench", lambda: runs)
    assert [pace_on(name).factor for name in ("Simulated bench", "Quick", "New")] == [2.5, 1.0, 1.5]


@pytest.mark.parametrize("station", ["Simulated bench", ""])
@pytest.mark.parametrize(("factor", "runs"), [(1.0, 7), (1.9, 7), (2.5, 7), (2.5, 1)])
def test_the_forecast_has_this_pace_and_says_why_from_twice_on(factor, runs, station):
    job = JobConfig(name="a", sequence="three_pose", station="simulated")
    queue = Queue(format="starbench/queue/1", name="n", jobs=[job])
    night = plan_batch(queue, BEGUN, {station: Pace(factor, runs, station)})
    (slot,) = night.slots
    assert slot.end_s - slot.begin_s == pytest.approx(factor * planned_duration_s(job))
    place = f"On station {station}" if station else "On this computer"
    last = "the last run" if runs == 1 else "the last 7 runs"
    is_told = [text.startswith(f"{place}, {last} took 2.5 times") for text in night.slow]
    assert is_told == ([True] if factor > 2 else [])
