"""After a run that did not finish, the command that is offered is one that can work."""

import pytest

from bench.base.failure import Failure
from bench.record.history import Attempt, History, way_on


def ended(kind, *, how="failed", recorded=1, accepted=True):
    history = History()
    history.ended = how
    history.started = {"begun_with": ["nine_pose", "--station", "my bench.yaml"]}
    history.failures = [Failure(kind, "w")]
    history.attempts = [Attempt(1, "left", 1, {})] * recorded
    history.accepted = lambda: dict(enumerate(history.attempts)) if accepted else {}
    return history


@pytest.mark.parametrize(
    ("history", "command"),
    [
        (ended("DegenerateViews"), "starbench calibrate 'cam 7' --model joint"),
        (ended("OutsideLimits", recorded=0), "starbench run nine_pose --station 'my bench.yaml'"),
        (ended("PreflightFailed", recorded=0), "starbench run nine_pose --station 'my bench.yaml'"),
        (ended("PreflightFailed"), "starbench resume 'cam 7'"),
        (ended("PoseFailed"), "starbench resume 'cam 7'"),
        (ended("PoseFailed", accepted=False), "starbench run nine_pose --station 'my bench.yaml'"),
        (ended("OutsideLimits", how="aborted", recorded=0), "starbench resume 'cam 7'"),
        (History(), "starbench resume 'cam 7'"),
    ],
)
def test_the_command_can_work(tmp_path, monkeypatch, history, command):
    monkeypatch.chdir(tmp_path)
    assert way_on(history, tmp_path.relative_to(tmp_path) / "cam 7")[1] == command


def test_a_run_of_an_earlier_version_begins_again_with_the_copies_of_its_files(tmp_path):
    history = ended("PreflightFailed", recorded=0)
    history.started = {}
    run = tmp_path / "run"
    sentence, command = way_on(history, run)
    assert command == f"starbench run {run / 'sequence.yaml'} --station {run / 'station.yaml'}"
    assert f"`starbench resume {run}`" in sentence
