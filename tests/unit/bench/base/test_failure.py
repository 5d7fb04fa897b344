"""An error keeps its kind, place and remedy, from the driver that raises it up to journal and JSON."""

import inspect
import json
from dataclasses import replace

import pytest
from rehearsed import Scene

from bench.base.errors import BenchError, JournalBroken
from bench.base.failure import FORESEEN, Failure
from bench.commands.calibration_output import show_run
from bench.records.events import Event
from bench.records.history import replay
from bench.records.journal import read_journal
from bench.run.runner import RunEnd
from calib.errors import CalibrationError
from drivers.errors import DriverError, MoveFailed
from sequences.errors import SequencesError
from simulators.errors import SimulatorError

SLIPPED = {"kind": "MoveFailed", "what": "The axis slipped.", "where": "pan", "remedy": "Tighten the clamp."}


@pytest.mark.parametrize(
    "base",
    [BenchError, CalibrationError, DriverError, SequencesError, SimulatorError],
    ids=lambda e: e.__name__,
)
def test_errors_of_all_packages_have_one_shape(base):
    assert list(inspect.signature(base).parameters) == ["what", "where", "remedy"]
    error = base("It is dark.", where="the lamp", remedy="Switch it on.")
    assert (error.what, error.where, error.remedy) == ("It is dark.", "the lamp", "Switch it on.")
    assert str(error) == "the lamp: It is dark. Switch it on."
    assert str(base("It is dark.")) == "It is dark."


def test_a_failure_says_what_its_error_says():
    error = JournalBroken("Line 3 is cut off.", where="journal.jsonl", remedy="Restore it.")
    failure = Failure.of(error)
    assert failure.kind == "JournalBroken"
    assert failure.message == str(error)


def test_an_error_that_nobody_foresaw_is_a_defect():
    failure = Failure.of(ZeroDivisionError("division by zero"))
    assert failure.kind == "ZeroDivisionError"
    assert "defect" in failure.remedy
    assert ZeroDivisionError not in FORESEEN


def test_a_run_that_failed_keeps_kind_place_and_remedy_up_to_journal_and_json(tmp_path, capsys):
    def hook(name):
        if name == "stage.move_to":
            raise MoveFailed(SLIPPED["what"], where=SLIPPED["where"], remedy=SLIPPED["remedy"])

    scene = Scene(tmp_path)
    scene.hook = hook
    end = scene.run()
    assert end.failure == Failure(**SLIPPED)
    (told,) = scene.told(Event.RUN_ENDED)
    assert told["error"] == SLIPPED
    assert show_run(end, as_json=True) == 1
    said = json.loads(capsys.readouterr().out)["error"]
    assert said == {**SLIPPED, "message": "pan: The axis slipped. Tighten the clamp."}


@pytest.mark.parametrize(
    ("where", "opened", "text"),
    [
        ("open", False, "No device was used; nothing was moved or switched."),
        ("stage.move_to", True, "The bench is safe: stage stopped, light off."),
    ],
)
def test_a_failed_run_is_called_safe_only_if_devices_were_opened(tmp_path, capsys, where, opened, text):
    def hook(name):
        if name == where:
            raise MoveFailed(SLIPPED["what"])

    scene = Scene(tmp_path)
    scene.hook = hook
    end = scene.run()
    assert (end.how, end.opened) == ("failed", opened)
    assert show_run(end, as_json=False) == 1
    assert text in capsys.readouterr().err.splitlines()
    assert show_run(replace(end, unsafe=["the light"]), as_json=False) == 1
    assert ("safe" in capsys.readouterr().err) is False


def test_what_is_not_known_of_devices_never_opened_is_said(capsys, tmp_path):
    end = RunEnd("failed", "the port is missing", tmp_path, None)
    assert show_run(end, as_json=False) == 1
    assert (
        "Whether the light is on and the stage is still is not known: look at the bench."
        in capsys.readouterr().err
    )


def test_a_sequence_without_a_report_step_has_not_failed(capsys, tmp_path):
    assert show_run(RunEnd("finished", "", tmp_path, None, opened=True), as_json=False) == 0
    said = capsys.readouterr()
    assert "finished and sealed. Its sequence has no report step, so there is no result." in said.out
    assert "resume" not in said.out + said.err
    assert "failed" not in said.out + said.err


def test_a_resumed_run_knows_the_error_that_ended_it_before(tmp_path):
    failures = [MoveFailed(SLIPPED["what"], where=SLIPPED["where"], remedy=SLIPPED["remedy"])]

    def hook(name):
        if name == "stage.move_to" and failures:
            raise failures.pop()

    scene = Scene(tmp_path)
    scene.hook = hook
    assert scene.run().how == "failed"
    assert scene.run().how == "finished"
    assert replay(read_journal(scene.folder / "journal.jsonl")[0]).failures == [SLIPPED]


def test_a_run_that_was_aborted_has_no_failure(tmp_path):
    scene = Scene(tmp_path)
    scene.hook = lambda name: scene.clock.request_stop("enough") if name == "stage.move_to" else None
    end = scene.run()
    assert (end.how, end.failure) == ("aborted", None)
    assert "error" not in scene.told(Event.RUN_ENDED)[0]
