"""What the script language allows, and how it answers to what it does not."""

import pytest
from flat import faults_of


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("steps: []", "s.yaml:3:8: steps: must have 1 or more entries."),
        ("steps: [lihgt]", "s.yaml:3:9: steps[0].lihgt: unknown key. Did you mean 'light'?"),
        ("steps: [wait]", "s.yaml:3:9: steps[0].wait.duration_s: this key is required, but it is missing."),
        ("steps: [{light: off, move: {}}]", "steps[0]: a step has one key, of light, move, settle,"),
        ("steps: [[move]]", "s.yaml:3:9: steps[0]: must be a mapping (key: value)."),
        ("steps: [{repeat: {steps: [move]}}]", "s.yaml:3:18: steps[0].repeat: "),
        ("steps: [{repeat: {times: 2, poses: a, steps: [move]}}]", "s.yaml:3:18: steps[0].repeat: "),
        ("steps: [{solve: {distortion: [k1, k1]}}]", "steps[0].solve.distortion: a distortion term"),
        ("steps: [{solve: {distortion: [k1, kb1]}}]", "steps[0].solve.distortion: no lens model"),
        ("steps: [{solve: {distortion: k2k1}}]", "steps[0].solve.distortion: must be 'none', 'k1', "),
        ("steps: [{solve: {distortion: [k1, q]}}]", "steps[0].solve.distortion[1]: must be 'k1', "),
        ("steps: [{solve: {model: sphere}}]", "steps[0].solve.model: must be 'auto', 'joint', "),
        ("steps: [{solve: {passport: ''}}]", "steps[0].solve.passport: must not be empty (got '')."),
        ("steps: [{solve: {guard_band: 0}}]", "steps[0].solve.guard_band: must be from 0.05 to 1 (got '0')."),
        ("steps: [{light: of}]", "steps[0].light: must be 'on' or 'off' (got 'of'). Did you mean 'off'?"),
        ("steps: [{light: {duty_percent: 100}}]", "light.duty_percent: must be from 0.01 to 99.99 %"),
        ("steps: [{record: {attempts: 0}}]", "steps[0].record.attempts: must be 1 or more (got '0')."),
        ("defaults: {light: off}\nsteps: [light]", "defaults.light: must be a mapping"),
        ("defaults: {move: {pan_deg: 1}}\nsteps: [light]", "defaults.move: unknown key."),
        ("poses: {a: [{name: x}]}\nsteps: [light]", "poses.a[0]: a pose needs pan_deg,"),
        ("poses: {a: []}\nsteps: [light]", "poses.a: must have 1 or more entries."),
        ("poses: {a: {order: rows}}\nsteps: [light]", "poses.a: a grid needs pan_deg, tilt_deg or roll_deg."),
        ("poses: {a: {pan_deg: {first: 1, last: 2}}}\nsteps: [light]", "poses.a.pan_deg.count: this key"),
        ("poses: {' a': [{pan_deg: 1}]}\nsteps: [light]", "poses. a: must "),
        ("poses: {a: [{pan_deg: 361}]}\nsteps: [light]", "poses.a[0].pan_deg: must be 360 or less"),
    ],
    ids=lambda text: text[:45],
)
def test_what_the_language_does_not_allow_is_answered_at_its_place(text, fault):
    assert any(fault in each for each in faults_of(text + "\n")), faults_of(text + "\n")
