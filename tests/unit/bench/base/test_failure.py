"""An error keeps its kind, place and remedy, from the driver that raises it up to journal and JSON."""

import inspect
import json
from dataclasses import replace

import pytest
from json_form import with_json
from quick_runs import END, THREE
from rehearsed import Scene

from bench.base.errors import BenchError, JournalBroken, StorageError
from bench.base.failure import FORESEEN, Failure
from bench.base.progress import Progress
from bench.commands.run import show_run
from bench.record.device_end import DeviceEnd
from bench.record.events import Event
from bench.record.journal import read_journal
from bench.run.runner import RunEnd
from bench.run.status import line_text, read_status
from bench.run.steps_to_do import intentions
from calib.errors import CalibrationError
from drivers.errors import DriverError, MoveFailed, ReplyTimeout
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


def test_a_failure_says_what_its_error_says_and_one_that_nobody_foresaw_is_a_defect():
    error = JournalBroken("Line 3 is cut off.", where="journal.jsonl", remedy="Restore it.")
    assert (Failure.of(error).kind, Failure.of(error).message) == ("JournalBroken", str(error))
    defect = Failure.of(ZeroDivisionError("division by zero"))
    assert defect.kind == "ZeroDivisionError"
    assert "defect" in defect.remedy
    assert ZeroDivisionError not in FORESEEN


def scene_with(folder, errors):
    """A run on devices whose calls raise these errors, by the name of the call."""
    scene = Scene(folder)
    scene.errors = errors
    return scene


def slipped():
    return MoveFailed(SLIPPED["what"], where=SLIPPED["where"], remedy=SLIPPED["remedy"])


def test_a_run_that_failed_keeps_kind_place_and_remedy_up_to_journal_and_json(tmp_path, capsys):
    scene = scene_with(tmp_path, {"stage.move_to": slipped()})
    end = scene.run()
    assert end.failure == Failure(**SLIPPED)
    (run_end,) = scene.data_of(Event.RUN_ENDED)
    assert run_end["error"] == SLIPPED
    assert with_json(show_run, end) == 1
    error = json.loads(capsys.readouterr().out)["error"]
    assert error == {**SLIPPED, "message": "pan: The axis slipped. Tighten the clamp."}


@pytest.mark.parametrize(
    ("where", "opened", "text"),
    [
        ("open", False, "No device was ready, so none has answered."),
        ("stage.move_to", True, "The bench is safe; each device confirmed it:"),
    ],
)
def test_a_failed_run_is_called_safe_only_if_devices_were_opened(tmp_path, capsys, where, opened, text):
    end = scene_with(tmp_path, {where: slipped()}).run()
    assert (end.how, end.opened) == ("failed", opened)
    assert show_run(end) == 1
    assert text in capsys.readouterr().err.splitlines()
    ends = [DeviceEnd("stage", "confirmed safe", "at rest"), DeviceEnd("light", "not confirmed", "no answer")]
    assert show_run(replace(end, devices=ends)) == 1
    errors = capsys.readouterr().err
    assert "The bench is safe" not in errors
    assert "light: not confirmed" in errors
    assert "stage: confirmed safe" in errors


def test_how_each_device_was_left_stands_in_the_journal_and_in_json(tmp_path, capsys):
    silent = ReplyTimeout("no complete reply within 2 s.")
    scene = scene_with(tmp_path, {"stage.move_to": slipped(), "light.off": silent})
    end = scene.run()
    (run_end,) = scene.data_of(Event.RUN_ENDED)
    states = {device["device"]: device["state"] for device in run_end["devices"]}
    assert states == {"stage": "confirmed safe", "light": "not confirmed", "camera": "confirmed safe"}
    assert with_json(show_run, end) == 1
    answer = json.loads(capsys.readouterr().out)
    assert answer["devices"] == run_end["devices"]
    assert "no complete reply" in answer["devices"][1]["said"]
    assert answer["unsafe"] == [answer["devices"][1]["said"]]
    assert line_text(read_journal(scene.folder / "journal.jsonl")[0][-1]).endswith("light may be on.")


def test_an_error_that_no_driver_foresees_leaves_no_other_device_on(tmp_path):
    scene = scene_with(tmp_path, {"stage.stop": RuntimeError("can't start new thread")})
    scene.run()
    (run_end,) = scene.data_of(Event.RUN_ENDED)
    states = {device["device"]: device["state"] for device in run_end["devices"]}
    assert states == {"stage": "not confirmed", "light": "confirmed safe", "camera": "confirmed safe"}


def test_who_ends_the_process_while_devices_are_made_safe_is_told_to_check_the_bench(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr(Progress, "say", lambda _, text: said.append(text))
    with pytest.raises(KeyboardInterrupt):
        scene_with(tmp_path, {"stage.stop": KeyboardInterrupt()}).run()
    assert said[-1].startswith("CHECK THE BENCH")


def test_what_is_not_known_of_devices_never_opened_is_said(capsys, tmp_path):
    assert show_run(RunEnd("failed", "the port is missing", tmp_path, None)) == 1
    errors = capsys.readouterr().err
    assert "Look at the bench" in errors
    assert "moved nothing" not in errors


def test_a_run_that_fails_again_on_a_full_disk_and_needs_no_device_keeps_what_each_confirmed(
    tmp_path, monkeypatch, capsys
):
    """The second time it said that no device was ready, and that the light may be on."""

    def full(*_):
        raise StorageError("The disk is full.", where="views.h5", remedy="Make room.")

    monkeypatch.setattr("bench.batch.rehearsal.RehearsedResults.write", full)
    scene = Scene(tmp_path, poses=THREE, end=END)
    for opened, head in (
        (True, "The bench is safe; each device confirmed it:"),
        (False, "No device was needed. Each confirmed before that it was safe:"),
        (False, "No device was needed. Each confirmed before that it was safe:"),
    ):
        end = scene.run()
        assert (end.how, end.opened) == ("failed", opened)
        assert [device.state for device in end.devices] == ["confirmed safe"] * 3
        show_run(end)
        errors = capsys.readouterr().err
        assert head in errors.splitlines()
        assert "Look at the bench" not in errors
        assert [device.state for device in read_status(scene.folder).devices] == ["confirmed safe"] * 3
    history = scene.history()
    assert "(failed: views.h5: " in intentions(scene.task, history, None)[0]


def test_a_resumed_run_knows_the_error_that_ended_it_before(tmp_path):
    errors = {"stage.move_to": slipped()}
    scene = scene_with(tmp_path, errors)
    assert scene.run().how == "failed"
    errors.clear()
    assert scene.run().how == "finished"
    assert scene.history().failures == [Failure(**SLIPPED)]


@pytest.mark.parametrize(
    ("light", "camera", "head"),
    [
        ("confirmed safe", "never opened", "Stage and light confirmed that they are safe:"),
        ("not confirmed", "never opened", "CHECK THE BENCH."),
        ("never opened", "never opened", "CHECK THE BENCH."),
        ("confirmed safe", "not confirmed", "Stage and light confirmed that they are safe:"),
    ],
)
def test_a_camera_that_does_not_answer_is_no_reason_to_check_the_bench(tmp_path, capsys, light, camera, head):
    ends = [DeviceEnd("stage", "confirmed safe"), DeviceEnd("light", light), DeviceEnd("camera", camera)]
    end = RunEnd("failed", "no camera", tmp_path, None, devices=ends, opened=False)
    show_run(end)
    output = "".join(capsys.readouterr())
    assert head in output
    assert ("light may be on" in output) is (light != "confirmed safe")
