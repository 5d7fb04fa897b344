"""Runs that choose their poses: on virtual devices, to the goal; killed at every kind of line; and what else can happen."""

import json
import shutil

import pytest
from quick_runs import THREE, write_until
from rehearsed import Scene, with_runner

from bench.commands.run import show_run
from bench.record.events import Event
from bench.run.control import Command
from bench.run.status import read_status, status_text

NEVER = f"{{expanded_fx_px: 0.001, at_most: 5, start: {THREE}}}"
pytestmark = pytest.mark.usefixtures("coarse")


def until_scene(folder, until=NEVER, **more):
    folder.mkdir(parents=True, exist_ok=True)
    return Scene(folder, sequence=write_until(folder / "sequence.yaml", until), **more)


def decisions(scene):
    return [
        {name: value for name, value in decision.items() if name != "worked_s"}
        for decision in scene.data_of(Event.UNTIL_DECIDED)
    ]


def angles(scene):
    """Commanded angles of the accepted recordings, by pose."""
    accepted = {checked["pose"] for checked in scene.data_of(Event.ATTEMPT_CHECKED) if checked["accepted"]}
    stored = scene.data_of(Event.CAPTURE_STORED)
    return {capture["pose"]: capture["commanded_deg"] for capture in stored if capture["pose"] in accepted}


def test_a_run_chooses_poses_until_its_bound_and_leaves_out_the_rest(tmp_path, capsys):
    scene = until_scene(tmp_path, NEVER)
    end = scene.run()
    assert end.how == "finished"
    decided = decisions(scene)
    assert [decision["recorded"] for decision in decided] == [3, 4, 5]
    assert all("chosen" in decision for decision in decided[:-1])
    assert decided[-1]["ended"] == "at_most"
    assert "U(fx) is" in decided[-1]["why"]
    assert len(angles(scene)) == 5
    states = scene.states()
    assert states.count("choosing") == 3
    assert states[-5:] == ["lighting", "parking", "solving", "reporting", "finished"]
    assert not scene.light_is_on()
    results = json.loads((scene.folder / "results.json").read_text())
    assert results["untils"][-1]["ended"] == "at_most"
    missed = f"The goal of a step was not met. {decided[-1]['why']}"
    assert "; the goal is 0.001 px." in missed
    assert missed in status_text(read_status(scene.folder)).splitlines()
    show_run(end)
    assert capsys.readouterr().out.splitlines()[0] == missed


def test_cut_off_before_and_after_its_decision_it_goes_on_with_the_same_poses(tmp_path):
    whole = until_scene(tmp_path / "whole", NEVER)
    whole.run()
    lines = (whole.folder / "journal.jsonl").read_bytes().splitlines(keepends=True)
    begin = 1 + [data.get("state") for _, data in whole.events()].index("choosing")
    for cut in (begin, begin + 1, begin + 4):  # no decision yet; decided; the stage moves
        scene = until_scene(tmp_path / f"cut-{cut}", NEVER)
        shutil.copytree(whole.folder, scene.folder)
        (scene.folder / "journal.jsonl").write_bytes(b"".join(lines[:cut]))
        assert scene.run().how == "finished"
        assert decisions(scene)[0] == decisions(whole)[0], cut
        steps, due = ([decision["step"] for decision in decisions(of)] for of in (scene, whole))
        assert steps == due, cut
        # A recording made again has other noise, but not another pose.
        assert angles(scene) == angles(whole), cut


def test_a_chosen_pose_that_is_skipped_is_not_chosen_again_and_a_later_one_cannot_be_skipped_yet(
    tmp_path, monkeypatch
):
    scene = with_runner(until_scene(tmp_path, NEVER), monkeypatch)
    refused = []

    def skip():
        for pose in (9, 4):
            scene.runner.inbox.decide(Command(word="skip", by="ada", pose=pose), str(pose))
        refused.extend(scene.data_of(Event.COMMANDED))

    scene.at("stage.move_to", 4, skip)
    assert scene.run().how == "finished"
    assert [answer["taken"] for answer in refused] == [False, True]
    assert sorted(angles(scene)) == [1, 2, 3, 5, 6]
    left_out, *others = [made["chosen"]["angles_deg"] for made in decisions(scene) if "chosen" in made]
    assert left_out not in others
    assert decisions(scene)[-1]["ended"] == "at_most"


def test_without_a_start_it_begins_with_what_the_station_expects(tmp_path):
    scene = until_scene(tmp_path, "{expanded_fx_px: 0.001, at_most: 4}")
    assert scene.run().how == "finished"
    decided = decisions(scene)
    assert [decision["recorded"] for decision in decided] == [0, 1, 2, 3, 4]
    assert decided[0]["now"] == decided[1]["now"] == {}
    assert decided[-1]["now"]["expanded_fx_px"] > 0
    assert len(angles(scene)) == 4


def test_poses_recorded_before_it_count_in_the_calibration_but_not_in_its_bound(tmp_path):
    text = write_until(tmp_path / "s.yaml", "{expanded_fx_px: 0.001, at_most: 2}").read_text()
    before = f"  - repeat: {{poses: {THREE}, steps: [move, settle, record]}}\n  - until:"
    (tmp_path / "s.yaml").write_text(text.replace("  - until:", before))
    scene = Scene(tmp_path, sequence=tmp_path / "s.yaml")
    assert scene.run().how == "finished"
    counts = [(decision["poses"], decision["recorded"]) for decision in decisions(scene)]
    assert counts == [(3, 0), (4, 1), (5, 2)]
