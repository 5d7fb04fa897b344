"""After a run that did not finish, the command that is offered is one that can work."""

import pytest

from bench.base.failure import Failure
from bench.record.history import Attempt, History, way_on


def ended(kind, *, how="failed", recorded=1, accepted=True, old=False):
    history = History()
    history.ended = how
    history.started = {} if old else {"begun_with": ["nine_pose", "--station", "my bench.yaml"]}
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
        (
            ended("PoseFailed", recorded=0, old=True),
            "starbench run 'cam 7/sequence.yaml' --station 'cam 7/station.yaml'",
        ),
        (ended("PreflightFailed"), "starbench resume 'cam 7'"),
        (ended("PoseFailed"), "starbench resume 'cam 7'"),
        (ended("PoseFailed", accepted=False), "starbench run nine_pose --station 'my bench.yaml'"),
        (ended("OutsideLimits", how="aborted", recorded=0), "starbench resume 'cam 7'"),
        (History(), "starbench resume 'cam 7'"),
    ],
)
def test_the_command_can_work(tmp_path, monkeypatch, history, command):
    monkeypatch.chdir(tmp_path)
    sentence, told = way_on(history, tmp_path.relative_to(tmp_path) / "cam 7")
    assert told == command
    assert ("`starbench resume 'cam 7'`" in sentence) == told.startswith("starbench run")
