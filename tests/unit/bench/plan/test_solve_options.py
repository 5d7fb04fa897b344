"""The words of a solve step are those of the engine, and reach it."""

from typing import get_args

import pytest
from flat import flatten

from bench.plan.job import calibration_options
from calib.calibration import LossName, ModelName
from calib.model.camera import BROWN, DISTORTION_SETS, FISHEYE, SKEW
from sequences import solve_schema as schema
from sequences.reader import check_document
from sequences.schema import Sequence

TEXT = "format: starbench/sequence/1\nname: S\nsteps: [{move: {pan_deg: 1}}, record, {solve: %s}]\n"


def solve_step(settings: str):
    return flatten(check_document((TEXT % settings).encode(), "s.yaml", Sequence))[-1]


def test_the_script_language_has_every_model_lens_and_loss_of_the_engine():
    assert set(get_args(schema.CalibrationModel)) == set(get_args(ModelName))
    assert set(get_args(schema.Loss)) == set(get_args(LossName))
    assert ((*BROWN, SKEW), FISHEYE) == schema.LENS_FAMILIES
    assert get_args(schema.DistortionTerm) == (*BROWN, SKEW, *FISHEYE)
    assert dict(schema.DISTORTION_SETS) == dict(DISTORTION_SETS)
    assert set(get_args(schema.DistortionSet)) == {*DISTORTION_SETS, "auto"}
    limits = set(schema.LimitConfig.model_fields)
    assert {f"sigma_{name}" for name in (*BROWN, "skew_px", *FISHEYE)} <= limits


@pytest.mark.parametrize("model", get_args(schema.CalibrationModel))
def test_every_model_reaches_the_engine(model):
    assert calibration_options(solve_step(f"{{model: {model}}}")).model == model


@pytest.mark.parametrize("name", DISTORTION_SETS)
def test_every_set_of_lens_coefficients_reaches_the_engine(name):
    assert calibration_options(solve_step(f"{{distortion: {name}}}")).distortion == DISTORTION_SETS[name]


def test_the_other_settings_reach_the_engine():
    made = calibration_options(
        solve_step("{loss: l2, huber_px: 0.5, guard_band: 0.9, drift_mm: 0.2, distortion: [kb2, kb1]}")
    )
    assert (made.loss, made.huber_px, made.guard_band, made.drift_mm) == ("l2", 0.5, 0.9, 0.2)
    assert made.distortion == ("kb1", "kb2")
