"""A night on a virtual clock: hours in seconds, the same bytes for the same seed, and never taken for evidence."""

import json
from datetime import UTC, datetime

import pytest
from station_texts import PLAIN

from bench.base.clock import BenchClock, VirtualClock
from bench.base.errors import RunFolderError, ScriptError, UsageError
from bench.batch.batch import Batch
from bench.batch.batch_plan import plan_batch, read_queue
from bench.batch.batch_rehearsal import rehearse_batch
from bench.batch.rehearsal import rehearse_run
from bench.batch.supervisor import WorkerEnd
from bench.record.journal import read_journal
from bench.record.run_index import read_run_and_details
from bench.run.launch import Launch, read_intentions, resume_run
from bench.stations.station import SHIPPED_STATIONS
from sequences.schema import GateConfig

EVENING = datetime(2026, 3, 1, 18, 30, tzinfo=UTC)
QUEUE = """\
format: starbench/queue/1
name: Night
zone: Europe/Berlin
start_at: "20:00"
stop_by: "22:10"
jobs:
  - {name: a, sequence: three_pose, station: station.yaml, times: 2, every_min: 60}
  - {name: b, sequence: three_pose, station: other.yaml, priority: 1}
"""
TWELVE = """\
format: starbench/sequence/1
name: Often
poses:
  few: [{pan_deg: -6, tilt_deg: 2}, {pan_deg: 6, tilt_deg: 2}, {pan_deg: 0, tilt_deg: -3}]
steps:
  - light
  - repeat: {times: 4, steps: [{repeat: {poses: few, steps: [move, {record: {attempts: 3, on_failure: skip}}]}}]}
  - light: off
  - solve: {model: spherical, distortion: [k1]}
  - report
"""


@pytest.fixture
def queue(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    mishaps = "simulation: {rehearsal: {lost_share: 0.1, covered_share: 0.1, room_c_per_h: -1}}"
    (folder / "station.yaml").write_text(PLAIN.replace("simulation: {}", mishaps))
    (folder / "other.yaml").write_text(PLAIN.replace("simulation: {}", "simulation: {camera_serial: '7'}"))
    (folder / "queue.yaml").write_text(QUEUE)
    return read_queue(folder / "queue.yaml")


def rehearsed(queue, folder, seed=1, **more):
    return rehearse_batch(queue, folder, begin=EVENING, seed=seed, say=lambda _: None, **more)


def journals(folder):
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("journal.jsonl"))}


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes_and_another_seed_others(queue, tmp_path):
    (tmp_path / "files" / "short.yaml").write_text(
        QUEUE.replace("times: 2", "times: 1").partition("  - {name: b")[0]
    )
    short = read_queue(tmp_path / "files" / "short.yaml")
    rehearsed(short, tmp_path / "one")
    rehearsed(short, tmp_path / "again")
    rehearsed(short, tmp_path / "other", seed=2)
    first, again, other = (journals(tmp_path / name) for name in ("one", "again", "other"))
    assert sorted(first) == ["journal.jsonl", "runs/a-001/journal.jsonl"]
    assert first == again
    assert first["runs/a-001/journal.jsonl"] != other["runs/a-001/journal.jsonl"]
    for name in ("one/summary.json", "one/summary.html"):
        again = name.replace("one", "again")
        assert (tmp_path / name).read_bytes() == (tmp_path / again).read_bytes()


def test_a_night_goes_as_planned_and_tells_what_failed(queue, tmp_path):
    reached: list[tuple[int, int]] = []
    summary = rehearsed(queue, tmp_path / "night", progress=lambda *done: reached.append(done))
    assert sorted(set(reached)) == [(done, 3) for done in range(3)]
    planned = {slot.item.key: slot for slot in plan_batch(queue.value, EVENING).slots}
    assert {item["item"]: item["how"] for item in summary["items"]} == {
        "a-001": "finished", "a-002": "finished", "b-001": "failed",
    }  # fmt: skip
    for item in summary["items"]:
        begun = datetime.fromisoformat(item["begun_utc"])
        assert begun.minute % 30 in {0, 1}
        if item["how"] == "finished" and item["recordings"] == 3:
            expected = planned[item["item"]].end_s - planned[item["item"]].begin_s
            assert item["took_s"] == pytest.approx(expected, rel=0.05)
    (failed,) = (item for item in summary["items"] if item["item"] == "b-001")
    assert "the camera has 7" in failed["why"]
    assert failed["attempts"] == 2
    temperatures = [item["temperature_c"] for item in summary["items"] if item["how"] == "finished"]
    assert temperatures[1] > temperatures[0]  # it warms up, while the room cools
    page = (tmp_path / "night" / "summary.html").read_text(encoding="utf-8")
    assert "REHEARSAL" in page
    assert "the camera has 7" in page
    assert "http" not in page.replace("http://www.w3.org", "")


@pytest.mark.slow
def test_a_rehearsal_leaves_nothing_that_passes_for_evidence(queue, tmp_path, monkeypatch):
    home = tmp_path / "home"
    monkeypatch.setenv("STARBENCH_HOME", str(home))
    rehearsed(queue, tmp_path / "night")
    run = tmp_path / "night" / "runs" / "a-001"
    assert not home.exists()  # no key, no ledger, no message
    assert not (run / "SHA256SUMS.sig").exists()
    first = read_journal(run / "journal.jsonl")[0][0]
    assert (first.data["rehearsal"], first.data["simulated"]) == (True, True)
    assert json.loads((run / "results.json").read_text())["rehearsal"] is True
    assert (run / "captures" / "pose-001-attempt-1.raw").read_bytes().startswith(b"% REHEARSAL")
    with pytest.raises(RunFolderError, match="rehearsal"):
        resume_run(run, Launch(BenchClock()))
    with pytest.raises(RunFolderError, match="rehearsal"):
        read_intentions(run)
    with pytest.raises(UsageError, match="not empty"):
        rehearsed(queue, tmp_path / "night")
    real = Batch(
        tmp_path / "night", queue, VirtualClock(EVENING), print, lambda *_: WorkerEnd("finished", "")
    )
    with pytest.raises(RunFolderError, match="same folder"):
        real.run()


def events_of_one_run(folder, sequence="three_pose", station="simulated", seed=1, how="finished", **more):
    clock = VirtualClock(EVENING)
    end = rehearse_run(
        str(sequence), str(station), seed=seed, operator=None, folder=folder / "run", clock=clock, **more
    )
    assert end.how == how, end.why
    return read_journal(folder / "run" / "journal.jsonl")[0]


def test_mishaps_are_tried_again_skipped_and_told_as_in_a_run(tmp_path):
    (tmp_path / "often.yaml").write_text(TWELVE)
    mishaps = "simulation: {rehearsal: {lost_share: 0.25, covered_share: 0.25}}"
    (tmp_path / "station.yaml").write_text(PLAIN.replace("simulation: {}", mishaps))
    entries = events_of_one_run(tmp_path, tmp_path / "often.yaml", tmp_path / "station.yaml", seed=5)
    run, _ = read_run_and_details(tmp_path / "run")
    events = [entry.event for entry in entries]
    refused = [entry for entry in entries if entry.event == "attempt_checked"]
    assert run.recordings > 12 >= run.accepted >= 6
    assert events.count("attempt_lost") >= 2
    assert any("stars 20, needed >= 40" in e.data["reasons"] for e in refused)
    assert run.deviations == 12 - run.accepted


def test_each_gate_is_judged_by_a_virtual_number_or_said_to_have_none(tmp_path):
    stated = set(GateConfig.model_fields) - {"require_triggers", "max_event_rate_mev_s"}
    gates = {name: "0" if name.startswith("max_") else "100000" for name in stated}
    record = {"attempts": "1", "on_failure": "skip"} | {
        f"gates.{name}": limit for name, limit in gates.items()
    }
    settings = {f"sequence.defaults.record.{name}": value for name, value in record.items()}
    entries = events_of_one_run(tmp_path, settings=settings, how="failed")
    told = " ".join(str(entry.data["what"]) for entry in entries if entry.event == "deviation")
    unjudged = {name for name in stated if f" {name} " in told}
    judged = next(entry.data["gates"] for entry in entries if entry.event == "attempt_checked")
    fixed = {"event rate", "pan moved", "tilt moved"}
    assert len([gate for gate in judged if gate["name"] not in fixed]) == len(stated - unjudged)
    assert {gate["name"] for gate in judged if gate["verdict"] == "fail"} == {"stars", "data rate"}
    assert {"max_motion_px", "max_silent_rows", "max_trigger_jitter_us"} <= stated - unjudged
    assert {"max_edge_width_px", "min_lit_pixels"} <= unjudged


INTERLOCKS = """
interlocks:
  door: {path: /no/such/door, max_hold_s: 60}
  disk_space: {min_free_gb: 1000000, release_gb: 1000000}
  camera_temperature: {max_c: 39.5, release_c: 39.0, max_hold_s: 20000}
"""


def test_interlocks_of_the_bench_hold_in_virtual_time_those_of_this_room_do_not(tmp_path):
    cooling = "simulation: {rehearsal: {room_c: 25, room_c_per_h: -2, warm_up_min: 0}}"  # 43 C, then less
    (tmp_path / "station.yaml").write_text(PLAIN.replace("simulation: {}", cooling) + INTERLOCKS)
    entries = events_of_one_run(tmp_path, station=tmp_path / "station.yaml")
    held = [e for e in entries if e.event == "interlock_released"]
    assert [e.data["rule"] for e in held] == ["camera_temperature"]
    assert held[0].data["held_s"] == pytest.approx(2 * 3600, rel=0.01)


def test_the_run_folder_keeps_the_files_with_the_settings_in_them(tmp_path):
    settings = {"sequence.defaults.record.window_ms": "50", "sequence.name": "Longer"}
    entries = events_of_one_run(tmp_path, settings=settings)
    text = (tmp_path / "run" / "sequence.yaml").read_text(encoding="utf-8")
    assert "window_ms: '50'" in text
    assert "name: Longer" in text
    shipped = (SHIPPED_STATIONS / "simulated.yaml").read_bytes()
    assert (tmp_path / "run" / "station.yaml").read_bytes() == shipped
    stored = [e.data for e in entries if e.event == "capture_stored"]
    assert stored[0]["facts"]["duration_s"] == pytest.approx(4 / 60 + 1e-3)


def test_files_with_a_fault_are_refused_as_for_a_run(tmp_path):
    settings = {"station.stage.axes.pan.limits_deg": "[-1, 1]"}
    with pytest.raises(ScriptError, match="outside the limits"):
        rehearse_run(
            "three_pose", "simulated", seed=1, operator=None, folder=tmp_path / "run",
            clock=VirtualClock(EVENING), settings=settings,
        )  # fmt: skip
    assert not (tmp_path / "run").exists()
