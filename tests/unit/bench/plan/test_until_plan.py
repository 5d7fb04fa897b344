"""The plan of a run that chooses its poses: at least, at most, and what is refused."""

from pathlib import Path

import pytest
from station_texts import PLAIN

from bench.plan.job import Job, ParkStep
from bench.plan.plan import load_documents, make_plan
from bench.plan.plan_text import render_plan
from sequences.script import ChooseStep, LightStep, MoveStep

SHIPPED = Path(__file__).parents[4] / "sequences" / "until_good.yaml"


@pytest.fixture
def plan():
    return make_plan(*load_documents(str(SHIPPED), "simulated"))


def planned(tmp_path, until, *, station="simulated", more=""):
    path = tmp_path / "s.yaml"
    path.write_text(
        f"format: starbench/sequence/1\nname: t\n{more}steps:\n  - light\n  - until: {until}\n  - solve\n  - report\n"
    )
    return make_plan(*load_documents(str(path), str(station)))


def test_the_shipped_sequence_has_no_fault(plan):
    assert plan.faults == ()
    assert (len(plan.poses), plan.most_poses) == (3, 25)


def test_it_is_described_in_two_lines_with_the_longest_time(plan):
    text = render_plan(plan)
    assert "choose and record up to 22 poses, at most 20 min" in text
    assert "until U(fx) <= 2.5 px, U at the corners <= 1.5 px" in text
    assert text.splitlines()[-1].startswith("3 to 25 poses, at most about ")
    assert len([line for line in text.splitlines() if line.strip()]) < 25


def test_fewer_recordings_or_minutes_make_it_shorter_and_smaller(tmp_path):
    start = "start: [{pan_deg: -6}, {pan_deg: 6}, {tilt_deg: 3}]"
    many = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 25, {start}}}")
    few = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 5, {start}}}")
    short = planned(tmp_path, f"{{expanded_fx_px: 1, at_most: 25, minutes: 0.2, {start}}}")
    assert few.duration_s < short.duration_s < many.duration_s
    assert few.size_bytes < short.size_bytes < many.size_bytes
    assert few.most_bytes < many.most_bytes


def test_plan_json_names_the_rounds_and_the_bounds(plan):
    told = plan.to_dict()
    (until,) = told["untils"]
    assert told["most_poses"] == until["at_most"] == 25
    assert (until["starts"], until["minutes"]) == (3, 20)
    assert until["goals"] == {"expanded_fx_px": 2.5, "worst_corner_px": 1.5}
    assert len(told["poses"]) == 3
    assert told["steps"][until["first"] - 1]["what"] == "move"


def test_the_stage_parks_after_the_last_round(plan):
    job = Job.from_plan(plan, seed=1, operator=None)
    place = next(i for i, step in enumerate(job.steps) if isinstance(step, ParkStep))
    assert isinstance(job.steps[place - 1], LightStep)


def test_a_chosen_pose_has_its_angles_from_the_journal_and_others_turn_every_axis(plan):
    job = Job.from_plan(plan, seed=1, operator=None)
    moves = [step for step in job.steps if isinstance(step, MoveStep)]
    chosen = {4: {"pan": 1.5, "tilt": -2.0}}
    assert job.at_its_pose(moves[3], chosen).pose.angles_deg == {"pan": 1.5, "tilt": -2.0}
    assert job.at_its_pose(moves[2], chosen).pose.angles_deg == {"pan": 0.0, "tilt": -3.0}
    with pytest.raises(KeyError):
        job.at_its_pose(moves[4], chosen)


def test_it_cannot_begin_from_nothing_without_expectations(tmp_path):
    kept = [line for line in PLAIN.splitlines() if not line.startswith("expected:")]
    station = tmp_path / "b.yaml"
    station.write_text("\n".join(kept) + "\n")
    assert not planned(tmp_path, "{expanded_fx_px: 1}").faults
    found = {fault.message for fault in planned(tmp_path, "{expanded_fx_px: 1}", station=station).faults}
    (message,) = found
    assert "record at least 2 poses before (start:), or add an expected section" in message


def test_a_start_outside_the_limits_and_recordings_in_the_dark_are_refused(tmp_path):
    found = planned(tmp_path, "{expanded_fx_px: 1, start: [{pan_deg: 40}, {pan_deg: 1}]}").faults
    assert any("pan 40 deg is outside the limits" in fault.message for fault in found)
    path = tmp_path / "dark.yaml"
    path.write_text(
        "format: starbench/sequence/1\nname: t\n"
        "steps: [{until: {expanded_fx_px: 1, start: [{pan_deg: 1}, {pan_deg: 2}]}}, solve, report]\n"
    )
    (fault,) = make_plan(*load_documents(str(path), "simulated")).faults
    assert "in the dark" in fault.message


def test_a_choice_uses_the_same_passport_as_the_solve():
    certificate = {
        "station.collimator.certificate.r_mm": "255",
        "station.collimator.certificate.uncertainty_mm": "0.1",
        "station.collimator.certificate.k": "2",
        "station.collimator.certificate.number": "C-1",
    }
    plan = make_plan(*load_documents(str(SHIPPED), "simulated", certificate))
    assert not plan.faults
    steps = [step for step in plan.script if isinstance(step, ChooseStep)]
    assert plan.passport.in_use is not None
    assert all(plan.passport_for(step.solve) is plan.passport.in_use.passport for step in steps)
