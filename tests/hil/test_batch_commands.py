"""Commands about batches, as an operator types them: a night planned, rehearsed, looked at, asked."""

import json
from pathlib import Path
from shutil import copyfile

import pytest
from quick_runs import write_queue
from running import called
from shared_folder import shared_folder

from bench.base.clock import BenchClock
from bench.batch.batch_record import BatchEvent
from bench.record.journal import Journal
from bench.record.run_folder import JOURNAL
from bench.record.run_index import QUEUE_COPY

ROOT = Path(__file__).parents[2]
TIMES = 'name: Night\nzone: Europe/Berlin\nstart_at: "21:00"\nstop_by: "21:45"\n'
RUNS = "name: a, sequence: three_pose, station: simulated, times: 3, every_min: 30, seed: 1"
JOB = "format: starbench/job/1\nname: more\nsequence: three_pose\nstation: simulated\n"


@pytest.fixture(scope="session")
def night(tmp_path_factory):
    """Folder of a rehearsed night."""

    def make(folder):
        queue = write_queue(folder / "queue.yaml", RUNS, head=TIMES)
        (folder / "job.yaml").write_text(JOB)
        words = ("rehearse", queue, "-o", folder / "out", "--begin", "2026-03-01T20:30")
        ended = called(*words, home=folder / "home", status=1)  # no time was left for a-003
        assert "rehearsed in" in ended.stderr

    return shared_folder(tmp_path_factory, "night", make)


def test_a_queue_is_planned_with_its_times_and_what_there_is_no_time_for(night):
    words = ("plan", night / "queue.yaml", "--begin", "2026-03-01T20:30")
    ended = called(*words, home=night / "home")
    assert "from Sun 2026-03-01 21:00 CET" in ended.stdout
    assert "No time for 1: a-003" in ended.stdout
    assert "2 runs, until Sun 21:30 CET" in ended.stdout
    plan = json.loads(called(*words, "--json", home=night / "home").stdout)
    assert plan["opens_utc"] == "2026-03-01T20:00:00+00:00"
    assert (plan["runs"], plan["no_time_for"]) == (2, ["a-003"])
    assert 0.1 < plan["expected_sigma"]["a"]["fx"] < 5


def test_a_queue_names_its_stations_itself_and_a_sequence_needs_one(night):
    both = called("plan", night / "queue.yaml", "-s", "simulated", home=night / "home", status=2)
    assert "names its stations itself" in both.stderr
    none = called("plan", "three_pose", home=night / "home", status=2)
    assert "--station" in none.stderr


def test_a_rehearsal_ends_as_its_night_would(night):
    summary = json.loads((night / "out" / "summary.json").read_text())
    assert (summary["how"], summary["rehearsal"]) == ("stopped", True)
    assert summary["why"].endswith(": a-003")
    assert (night / "out" / "summary.html").is_file()


def test_a_finished_batch_is_looked_at_summed_up_and_its_runs_are_listed(night):
    status = called("status", night / "out", home=night / "home")
    assert "Batch Night  REHEARSAL: stopped" in status.stdout
    assert "2 runs with a result, 0 without" in status.stdout
    before = (night / "out" / "summary.json").read_bytes()
    again = called("status", night / "out", "--summary", home=night / "home", status=1)
    assert "Camera 00050423, joint model, 2 results" in again.stdout
    assert (night / "out" / "summary.json").read_bytes() == before
    runs = called("runs", night / "out", home=night / "home")
    assert runs.stdout.count("REHEARSAL") == 2


def test_a_job_is_stored_for_a_batch_that_no_process_works_on(night, tmp_path):
    copyfile(night / "out" / QUEUE_COPY, tmp_path / QUEUE_COPY)
    clock = BenchClock()
    with Journal.create(tmp_path / JOURNAL, clock) as journal:
        journal.append(BatchEvent.BEGUN, queue="Night", files={})
    ended = called("tell", tmp_path, "add", night / "job.yaml", home=night / "home")
    assert "when it continues" in ended.stdout
    assert len(list((tmp_path / "requests").iterdir())) == 1


def test_a_request_to_a_rehearsal_or_to_no_batch_is_refused(night):
    ended = called("tell", night / "out", "add", night / "job.yaml", home=night / "home", status=1)
    assert "is a rehearsal" in ended.stderr
    nowhere = called("tell", night, "withdraw", "a", home=night / "home", status=1)
    assert "no batch" in nowhere.stderr


def test_the_demonstration_is_a_night_of_sixty_runs_of_nine_poses(night):
    words = ("plan", ROOT / "sequences" / "night" / "queue.yaml", "--begin", "2026-03-01T19:30", "--json")
    plan = json.loads(called(*words, home=night / "home").stdout)
    assert (plan["runs"], plan["no_time_for"]) == (60, [])
    assert plan["end_utc"] > "2026-03-02T04:00"
