"""After the result of a run is printed, nothing changes the exit status any more."""

import os
import signal
from types import SimpleNamespace

import pytest

from bench.commands import calibration_output, cli


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_after_the_result_does_not_change_the_exit_status(monkeypatch, tmp_path, name):
    kept = []

    def keep(folder):
        os.kill(os.getpid(), getattr(signal, name))
        kept.append(folder)

    monkeypatch.setattr(cli, "keep_answer_of_run", keep)
    monkeypatch.setattr(calibration_output, "show_run", lambda _end, **_: 0)
    end = SimpleNamespace(how="finished", outcome=object(), folder=tmp_path)
    assert cli._shown(end, as_json=False) == 0
    assert kept == [tmp_path]


@pytest.mark.parametrize(("how", "outcome"), [("aborted", object()), ("finished", None)])
def test_a_run_without_a_result_keeps_no_answer(monkeypatch, how, outcome):
    monkeypatch.setattr(cli, "keep_answer_of_run", lambda _folder: pytest.fail("kept"))
    monkeypatch.setattr(calibration_output, "show_run", lambda _end, **_: 3)
    assert cli._shown(SimpleNamespace(how=how, outcome=outcome), as_json=False) == 3
