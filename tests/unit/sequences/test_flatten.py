"""How a sequence unfolds into steps: poses, repeats, defaults, numbers that stay, and what cannot unfold."""

import re
from collections.abc import Sequence as List

import pytest
from flat import faults_of, read, steps_of
from slow_cases import slow

from sequences.flatten import MOST_STEPS, unfold
from sequences.script import Flicker, Gates, LightStep, MoveStep, RecordStep, ReportStep, Step


def poses(script: List[Step]) -> list[tuple[int, str, dict[str, float]]]:
    return [(s.pose.index, s.pose.name, s.pose.angles_deg) for s in script if isinstance(s, RecordStep)]


def test_bare_words_stand_for_steps_with_their_defaults():
    light, move, settle, record, solve, report = steps_of(
        "steps: [light, {move: {pan_deg: 1}}, settle, record, solve, report]\n"
    )
    assert light == LightStep(1, "s.yaml:3:9", ("steps", 0, "light"), Flicker("square", 60, 50, 100))
    assert isinstance(move, MoveStep)
    assert settle.duration_s == 0.5
    assert (record.window_ms, record.image, record.attempts) == (33, "auto", 2)
    assert record.gates == Gates(min_stars=40, max_event_rate_mev_s=200, require_triggers=True)
    assert (solve.model, solve.distortion, solve.loss, solve.huber_px) == (None, ("k1", "k2"), None, None)
    assert (solve.passport, solve.readings, solve.guard_band) == (None, "auto", 1.0)
    assert isinstance(report, ReportStep)


def test_a_step_takes_from_the_defaults_what_it_does_not_say_itself():
    light, _, record, off, _ = steps_of(
        "defaults:\n"
        "  light: {frequency_hz: 80, duty_percent: 30}\n"
        "  record: {window_ms: 50, attempts: 5, gates: {min_stars: 7, require_triggers: no}}\n"
        "steps:\n"
        "  - light: {duty_percent: 40}\n"
        "  - move: {pan_deg: 0}\n"
        "  - record: {attempts: 3, gates: {min_stars: 9}}\n"
        "  - light: off\n"
        "  - light: {output: off, frequency_hz: 70}\n"
    )
    assert light.flicker == Flicker("square", 80, 40, 100)
    assert (record.window_ms, record.attempts) == (50, 3)
    assert record.gates == Gates(min_stars=9, max_event_rate_mev_s=200, require_triggers=False)
    assert off.flicker is None


def test_limits_depend_on_the_waveform_and_the_sequence_always_wins():
    sine, square, given = (
        step.gates
        for step in steps_of(
            "steps:\n"
            "  - light: {waveform: sine}\n"
            "  - move: {pan_deg: 0}\n"
            "  - record\n"
            "  - light: {waveform: square}\n"
            "  - record\n"
            "  - light: {waveform: sine}\n"
            "  - record: {gates: {max_event_rate_mev_s: 200, max_flicker_disagreement_percent: 0.5}}\n"
        )
        if isinstance(step, RecordStep)
    )
    limits = [
        (record.max_event_rate_mev_s, record.limits["max_flicker_disagreement_percent"])
        for record in (sine, square, given)
    ]
    assert limits == [(500, 5), (200, 0.5), (200, 0.5)]


def test_an_axis_a_pose_does_not_name_stands_at_zero_wherever_the_camera_was_before():
    script = steps_of("steps: [{move: {pan_deg: 5, roll_deg: 3}}, record, {move: {tilt_deg: 1}}, record]\n")
    assert [angles for _, _, angles in poses(script)] == [
        {"pan": 5, "tilt": 0, "roll": 3},
        {"pan": 0, "tilt": 1, "roll": 0},
    ]


@pytest.mark.parametrize(("order", "back"), [("serpentine", [1, 0, -1]), ("rows", [-1, 0, 1])])
def test_a_grid_goes_along_pan_first(order, back):
    script = steps_of(
        "steps:\n  - repeat:\n"
        f"      poses: {{pan_deg: {{first: -1, last: 1, count: 3}}, tilt_deg: [2, 4, 5, 8], order: {order}}}\n"
        "      steps: [move, record]\n"
    )
    visited = [(a["pan"], a["tilt"]) for _, _, a in poses(script)]
    assert visited == [(p, t) for t in (2, 4, 5, 8) for p in (back if t in {4, 8} else [-1, 0, 1])]


def test_a_span_of_one_is_its_middle_and_a_long_one_ends_exactly():
    script = steps_of(
        "steps:\n  - repeat: {poses: {pan_deg: {first: 1, last: 3, count: 1}}, steps: [move, record]}\n"
        "  - repeat: {poses: {pan_deg: {first: -0.1, last: 0.2, count: 4}}, steps: [move, record]}\n"
    )
    pans = [angles["pan"] for _, _, angles in poses(script)]
    assert pans[0] == 2
    assert pans[-1] == 0.2  # and not -0.1 + 3 * 0.1, which is more


def test_recording_twice_at_one_place_gives_two_poses_with_names_of_their_own():
    script = steps_of("steps: [{move: {name: here, pan_deg: 1}}, {repeat: {times: 3, steps: [record]}}]\n")
    assert poses(script) == [
        (1, "here", {"pan": 1}),
        (2, "here (2)", {"pan": 1}),
        (3, "here (3)", {"pan": 1}),
    ]


def test_a_move_at_which_nothing_is_recorded_takes_no_number():
    script = steps_of("steps: [{move: {pan_deg: 1}}, {move: {pan_deg: 2}}, record, {move: {pan_deg: 0}}]\n")
    assert [step.pose.index for step in script if isinstance(step, MoveStep)] == [0, 1, 0]
    assert script[2].pose == script[1].pose


def test_repeats_nest_and_the_inner_pose_wins():
    script = steps_of(
        "poses: {a: [{pan_deg: 1}, {pan_deg: 2}], b: [{pan_deg: 9}]}\n"
        "steps:\n  - repeat:\n      poses: a\n      steps:\n"
        "        - repeat: {times: 2, steps: [move, record]}\n"
        "        - repeat: {poses: b, steps: [move, record]}\n"
    )
    assert [angles["pan"] for _, _, angles in poses(script)] == [1, 1, 9, 2, 2, 9]


def test_all_that_cannot_unfold_is_reported_at_once():
    messages = faults_of(
        "poses:\n  three: [{pan_deg: 1}]\n"
        "steps:\n  - record\n  - move\n  - repeat: {poses: tree, steps: [move]}\n"
        "  - repeat: {times: 2, steps: [{move: {name: x}}]}\n"
    )
    beginnings = [
        "s.yaml:6:5: steps[0].record: a record before any move",
        "s.yaml:7:5: steps[1].move: no pose to move to",
        "s.yaml:8:21: steps[2].repeat.poses: no set of poses has this name (got 'tree'). Did you mean 'three'?",
        "s.yaml:9:39: steps[3].repeat.steps[0].move: no pose to move to",
    ]
    assert [a.startswith(b) for a, b in zip(messages, beginnings, strict=True)] == [True] * 4


@pytest.mark.parametrize(
    "repeated",
    [
        "times: 100000, steps: [move]",
        slow("times: 100000, steps: [{wait: {duration_s: 1}}]"),
        slow("poses: none, steps: [move]"),
    ],
)
def test_a_script_that_unfolds_without_end_is_stopped(repeated):
    text = f"steps: [{{repeat: {{times: 100000, steps: [{{repeat: {{{repeated}}}}}]}}}}]\n"
    assert len(unfold(read(text))[1]) == 1


def test_a_grid_that_unfolds_without_end_is_stopped():
    axis = "{first: 0, last: 1, count: 10000}"
    (fault,) = faults_of(
        f"steps: [{{repeat: {{poses: {{pan_deg: {axis}, tilt_deg: {axis}, roll_deg: {axis}}}, steps: [move]}}}}]\n"
    )
    assert re.search(f"1000000000000 poses; at most {MOST_STEPS}", fault)


def test_a_question_that_nobody_answers_ends_the_run_unless_the_sequence_says_otherwise():
    (prompt,) = steps_of("steps: [{prompt: {text: 'Is the lens cap off?'}}]\n")
    assert prompt.default == "abort"
