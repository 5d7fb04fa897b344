"""The check standard: what its chart says about a bench, and that it stops a batch before another camera is measured."""

import re
from datetime import timedelta

import pytest
from many_runs import BEGIN, VALUES, BenchOfRuns
from nights import begun, night
from station_texts import PLAIN, station_of

from bench.charts.check_standard import standard_problem
from sequences.queue import Queue
from sequences.reader import check_document

STANDARD = "check_standard: {serial: 00050001, every_days: 7, stop_batch: %s}\n"


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    return tmp_path / "home"


def station_text(more=STANDARD % "true"):
    return re.sub(r"(?m)^name: .*$", "name: Bench 1", PLAIN, count=1) + more


def measured(home, tmp_path, last=(), **facts):
    """24 runs of the standard, one a day, and the values of fx that follow them."""
    made = BenchOfRuns(home, tmp_path / "runs", **{"simulated": True, **facts})
    for day, fx in enumerate([*(3345.0 + 0.1 * (n * 7 % 5 - 2) for n in range(24)), *last]):
        made.run(begun=BEGIN + timedelta(days=day), values={**VALUES, "fx": fx})
    made.close()
    return BEGIN + timedelta(days=23 + len(last), hours=1)


@pytest.mark.parametrize(
    ("last", "days_later", "problem"),
    [
        ([], 0, ""),
        ([3347.0], 0, "is out of control in its newest run run-00025: fx."),
        ([3347.0, *(3345.0 + 0.1 * (n % 3 - 1) for n in range(15))], 0, ""),
        ([], 7, "was last measured 7.0 days ago; it is due every 7 days."),
    ],
    ids=["in control", "shifted", "mended", "not measured in time"],
)
def test_a_standard_out_of_control_or_not_measured_in_time_is_a_problem(
    home, tmp_path, last, days_later, problem
):
    now = measured(home, tmp_path, last) + timedelta(days=days_later)
    message = standard_problem(station_of(station_text()), home, now)
    assert message == (f"The check standard, camera 00050001, {problem}" if problem else "")
    assert standard_problem(station_of(station_text("")), home, now) == ""


@pytest.mark.parametrize("facts", [{"station": "Bench 2"}, {"simulated": False}])
def test_runs_of_another_station_or_kind_do_not_count(home, tmp_path, facts):
    now = measured(home, tmp_path, **facts)
    assert standard_problem(station_of(station_text()), home, now).endswith("on this station.")


@pytest.mark.parametrize(
    ("more", "camera", "done", "how"),
    [
        (STANDARD % "true", "", [], "stopped"),
        (STANDARD % "false", "", ["run a-001"], "finished"),
        (STANDARD % "true", "00050001", ["run a-001"], "finished"),
    ],
)
def test_a_batch_measures_no_other_camera_while_it_is_out_of_control(home, tmp_path, more, camera, done, how):
    measured(home, tmp_path, [3347.0])
    bench = tmp_path / "b.yaml"
    bench.write_text(station_text(more))
    setting = f", settings: {{station.camera.serial: '\"{camera}\"'}}" if camera else ""
    jobs = f"- {{name: a, sequence: three_pose, station: {bench}{setting}}}"
    queue = check_document(f"format: starbench/queue/1\nname: Q\njobs:\n  {jobs}\n".encode(), "q.yaml", Queue)
    batch, workers = night(tmp_path / "night", queue)
    summary = batch.run()
    assert (begun(workers), summary["how"]) == (done, how)
    if how == "stopped":
        assert summary["why"].endswith("run-00025: fx. Before a-001, measure it again.")
