"""Commands about batches, as an operator types them: a night planned, rehearsed, looked at, asked."""

import json
from pathlib import Path
from shutil import copyfile

import pytest
from running import called

from bench.base.clock import BenchClock
from bench.batch.batch_record import BatchEvent
from bench.record.journal import Journal
from bench.record.run_folder import JOURNAL
from bench.record.run_index import QUEUE_COPY

ROOT = Path(__file__).parents[2]
QUEUE = """\
format: starbench/queue/1
name: Night
zone: Europe/Berlin
start_at: "21:00"
stop_by: "21:45"
jobs:
  - {name: a, sequence: three_pose, station: simulated, times: 3, every_min: 30, seed: 1}
"""
JOB = "format: starbench/job/1\nname: more\nsequence: three_pose\nstation: simulated\n"


@pytest.fixture(scope="module")
def night(tmp_path_factory):
    """A rehearsed night, and where."""
    folder = tmp_path_factory.mktemp("night")
    (folder / "queue.yaml").write_text(QUEUE)
    (folder / "job.yaml").write_text(JOB)
    ended = called(
        "rehearse", folder / "queue.yaml", "-o", folder / "out", "--begin", "2026-03-01T20:30", "--json",
        home=folder / "home",
    )  # fmt: skip
    return folder, ended


def test_a_queue_is_planned_with_its_times_and_what_there_is_no_time_for(night):
    folder, _ = night
    words = ("plan", folder / "queue.yaml", "--begin", "2026-03-01T20:30")
    ended = called(*words, home=folder / "home")
    assert ended.returncode == 0, ended.stderr
    assert "from Sun 2026-03-01 21:00 CET" in ended.stdout
    assert "No time for 1: a-003" in ended.stdout
    assert "2 runs, until Sun 21:30 CET" in ended.stdout
    plan = json.loads(called(*words, "--json", home=folder / "home").stdout)
    assert (plan["opens_utc"], plan["runs"], plan["no_time_for"]) == (
        "2026-03-01T20:00:00+00:00",
        2,
        ["a-003"],
    )
    assert 0.1 < plan["expected_sigma"]["a"]["fx"] < 5


def test_a_queue_names_its_stations_itself_and_a_sequence_needs_one(night):
    folder, _ = night
    both = called("plan", folder / "queue.yaml", "-s", "simulated", home=folder / "home")
    assert both.returncode == 2
    assert "names its stations itself" in both.stderr
    none = called("plan", "three_pose", home=folder / "home")
    assert none.returncode == 2
    assert "--station" in none.stderr


def test_a_rehearsal_ends_as_its_night_would(night):
    folder, ended = night
    assert ended.returncode == 1  # no time was left for a-003
    summary = json.loads(ended.stdout)
    assert (summary["how"], summary["rehearsal"]) == ("stopped", True)
    assert summary["why"] == "no time was left for 1 runs: a-003"
    assert "rehearsed in" in ended.stderr
    assert (folder / "out" / "summary.html").is_file()


def test_a_finished_batch_is_looked_at_summed_up_and_its_runs_are_listed(night):
    folder, _ = night
    status = called("status", folder / "out", home=folder / "home")
    assert "Batch Night  REHEARSAL: stopped" in status.stdout
    assert "2 runs with a result, 0 without" in status.stdout
    before = (folder / "out" / "summary.json").read_bytes()
    again = called("status", folder / "out", "--summary", home=folder / "home")
    assert "Camera 00050423, joint model, 2 results" in again.stdout
    assert (folder / "out" / "summary.json").read_bytes() == before
    runs = called("runs", folder / "out", home=folder / "home")
    assert runs.stdout.count("REHEARSAL") == 2
    assert runs.returncode == 0, runs.stderr


def test_a_job_is_stored_for_a_batch_that_no_process_works_on(night, tmp_path):
    folder, _ = night
    copyfile(folder / "out" / QUEUE_COPY, tmp_path / QUEUE_COPY)
    clock = BenchClock()
    with Journal.create(tmp_path / JOURNAL, utc_now=clock.utc_now, monotonic=clock.monotonic) as journal:
        journal.append(BatchEvent.BEGUN, queue="Night", files={})
    ended = called("tell", tmp_path, "add", folder / "job.yaml", home=folder / "home")
    assert ended.returncode == 0, ended.stderr
    assert "when it continues" in ended.stdout
    assert len(list((tmp_path / "requests").iterdir())) == 1


def test_a_request_to_a_rehearsal_or_to_no_batch_is_refused(night):
    folder, _ = night
    ended = called("tell", folder / "out", "add", folder / "job.yaml", home=folder / "home")
    assert ended.returncode == 1
    assert "is a rehearsal" in ended.stderr
    nowhere = called("tell", folder, "withdraw", "a", home=folder / "home")
    assert nowhere.returncode == 1
    assert "no batch" in nowhere.stderr


def test_the_demonstration_is_a_night_of_sixty_runs_of_nine_poses(night):
    folder, _ = night
    words = ("plan", ROOT / "sequences" / "night" / "queue.yaml", "--begin", "2026-03-01T19:30", "--json")
    plan = json.loads(called(*words, home=folder / "home").stdout)
    assert (plan["runs"], plan["no_time_for"]) == (60, [])
    assert plan["end_utc"] > "2026-03-02T04:00"
