"""The step `until`: its settings, the rounds that it unfolds into, and the faults of a wrong setting."""

import pytest
from flat import faults_of, steps_of

from sequences.flatten import POSES_FAILED
from sequences.script import ChooseStep, LightStep, MoveStep, RecordStep, SettleStep

UNTIL = "steps:\n  - light\n  - until: {expanded_fx_px: 2, at_most: 4, start: [{pan_deg: -6}, {pan_deg: 6, tilt_deg: 1}]%s}\n  - light: off\n"


def test_it_unfolds_into_its_start_and_rounds_for_every_accepted_and_failed_pose():
    script = steps_of(UNTIL % "")
    rounds = 4 + POSES_FAILED - 1
    kinds = [type(step) for step in script]
    start = [MoveStep, SettleStep, RecordStep] * 2
    assert kinds == [
        LightStep,
        *start,
        *[ChooseStep, MoveStep, SettleStep, RecordStep] * rounds,
        ChooseStep,
        LightStep,
    ]
    assert [step.number for step in script] == list(range(1, len(script) + 1))
    choices = [step for step in script if isinstance(step, ChooseStep)]
    until = choices[0].until
    assert (until.first, until.last) == (2, len(script) - 1)
    assert (until.goals, until.at_most, until.minutes) == ({"expanded_fx_px": 2}, 4, None)
    assert (until.poses, until.starts) == (range(1, 3 + rounds), 2)
    assert all(choice.until is until for choice in choices)
    assert choices[-1].pose is None


def test_its_poses_have_numbers_and_names_but_no_angles():
    recorded = [step.pose for step in steps_of(UNTIL % "") if isinstance(step, RecordStep)]
    assert [pose.index for pose in recorded] == list(range(1, len(recorded) + 1))
    assert [pose.name for pose in recorded[:4]] == ["pan -6 tilt 0", "pan 6 tilt 1", "chosen 1", "chosen 2"]
    assert [pose.chosen_in_run for pose in recorded[:4]] == [False, False, True, True]
    assert recorded[2].angles_deg == {}


@pytest.mark.parametrize(
    ("defaults", "own", "expected"),
    [
        ("", "", "skip"),
        ("defaults: {record: {attempts: 3}}\n", "", "skip"),
        ("defaults: {record: {on_failure: hold}}\n", "", "hold"),
        ("defaults: {record: {on_failure: hold}}\n", ", record: {on_failure: fail}", "fail"),
    ],
)
def test_a_failed_pose_is_skipped_unless_the_document_says_otherwise(defaults, own, expected):
    records = [step for step in steps_of(defaults + UNTIL % own) if isinstance(step, RecordStep)]
    assert {step.on_failure for step in records} == {expected}


def test_its_calibrations_use_the_defaults_of_solve():
    script = steps_of("defaults: {solve: {model: planar, distortion: [k1]}}\n" + UNTIL % "")
    choice = next(step for step in script if isinstance(step, ChooseStep))
    assert (choice.solve.model, choice.solve.distortion) == ("planar", ("k1",))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("{}", "expanded_fx_px or worst_corner_px"),
        ("{expanded_fx_px: 0}", "expanded_fx_px: must be more than 0 (got '0')."),
        ("{expanded_fx_px: 1, at_most: 1}", "at_most: must be 2 or more"),
        ("{expanded_fx_px: 1, at_most: 501}", "at_most: must be 500 or less"),
        ("{expanded_fx: 1}", "unknown key. Did you mean 'expanded_fx_px'?"),
        ("{expanded_fx_px: 1, start: nowhere}", "(got 'nowhere')"),
        ("{expanded_fx_px: 1, at_most: 2, start: {pan_deg: [1, 2, 3]}}", "start has 3 poses"),
        ("{expanded_fx_px: 1, record: {attempts: 0}}", "record.attempts: must be 1 or more"),
    ],
)
def test_what_is_wrong_with_it(given, message):
    (fault,) = faults_of(f"steps:\n  - light\n  - until: {given}\n")
    assert message in fault
    assert fault.startswith("s.yaml:5:")


def test_a_record_after_it_needs_a_move():
    (fault,) = faults_of(UNTIL.replace("  - light: off\n", "  - record\n") % "")
    assert "record before any move" in fault
