"""After a run that did not finish, the command that is offered is one that can work."""

import pytest

from bench.record.history import Attempt, History, way_on


def ended(kind, *, how="failed", recorded=1):
    history = History()
    history.ended = how
    history.failures = [{"kind": kind, "what": "w", "where": "", "remedy": ""}]
    history.attempts = [Attempt(1, "left", 1, {})] * recorded
    return history


@pytest.mark.parametrize(
    ("history", "command"),
    [
        (ended("DegenerateViews"), "starbench calibrate run --model joint"),
        (ended("NotConverged"), "starbench calibrate run --model joint"),
        (ended("OutsideLimits", recorded=0), "starbench run SEQUENCE --station STATION"),
        (ended("PreflightFailed", recorded=0), "starbench run SEQUENCE --station STATION"),
        (ended("PreflightFailed"), "starbench resume run"),
        (ended("PoseFailed"), "starbench resume run"),
        (ended("OutsideLimits", how="aborted", recorded=0), "starbench resume run"),
        (History(), "starbench resume run"),
    ],
)
def test_the_command_can_work(tmp_path, monkeypatch, history, command):
    monkeypatch.chdir(tmp_path)
    assert way_on(history, tmp_path.relative_to(tmp_path) / "run")[1] == command
