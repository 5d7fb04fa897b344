"""A certificate states the focal length, or the length that the camera sees. They differ if the target is out of focus."""

from dataclasses import replace

import numpy as np
import pytest
from slow_cases import first_quick

from calib import CalibrationOptions, Passport, calibrate
from calib.errors import InputMismatch
from calib.joint.adjust import adjust
from calib.joint.knowledge import CERTIFICATE, FOCAL
from calib.joint.modes import modes_of
from calib.joint.posterior import posterior
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.target_focus import TargetFocus
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import views_of
from tests.support.drawn_benches import THREE, draw_bench
from tests.unit.calib.conftest import Bench

POSES = tuple((pan, tilt) for tilt in (-2.0, 0.0, 2.0) for pan in (-5.0, 0.0, 5.0))
BENCH = Bench(half_angle_deg=40.0, poses=POSES)  # sees 255 mm
NARROW = replace(BENCH, poses=((-1.0, 0.5), (1.0, 0.5), (0.0, -1.0)))  # which hardly show the focal length
DEFOCUS, TO_FOCUS_MM = 0.05, -60.0
FOCAL_MM = 255.0 - DEFOCUS * TO_FOCUS_MM


def solved(certified_mm, length=""):
    views = BENCH.views(np.random.default_rng(71), 0.02)
    rng = np.random.default_rng(72)
    read_deg = np.array(POSES) + 0.002 * rng.normal(size=(len(POSES), 2))
    angles = tuple({"pan_deg": pan, "tilt_deg": tilt} for pan, tilt in read_deg.tolist())
    bound = ParallaxBound(DEFOCUS, 0.01, 0.0, 0.5)
    options = CalibrationOptions(
        passport=Passport.of_radius(certified_mm, 0.05, length=length),
        gimbal=GimbalReadings(angles, 0.002, 2e-4, 0.002, bound),
    )
    return calibrate(views, options)


def at_fault(result):
    return next(witness for witness in result.witnesses if witness.name == CERTIFICATE).fault_probability


@pytest.mark.parametrize("certified_mm", [255.0, FOCAL_MM])
def test_a_certificate_that_does_not_say_which_length_it_states_is_right_either_way(certified_mm):
    result = solved(certified_mm)
    assert abs(result.camera.fx - BENCH.fx) < result.U["fx"] < 4.0
    assert at_fault(result) < 0.1
    assert not [note for note in result.notes if "certificate" in note]


def test_if_views_cannot_tell_the_uncertainty_covers_both_lengths_and_a_note_says_so():
    options = CalibrationOptions(passport=Passport.of_radius(FOCAL_MM, 0.05))
    result = calibrate(NARROW.views(np.random.default_rng(71), 0.05), options)
    assert result.U["fx"] > 20.0
    assert abs(result.camera.fx - BENCH.fx) < result.U["fx"]
    assert [note for note in result.notes if "which length it states" in note]


@pytest.mark.parametrize(("poses", "times"), first_quick([(3, 0.9669), (9, 0.9148)]))
def test_the_focal_length_is_weighed_with_pupils_of_its_own_if_a_hand_moves_the_camera(poses, times):
    """Before, the pupils that belong to the seen length hid the other one: fx was 2.6 and 7.8 U wrong."""
    drawn = WORLDS["product-S1" if poses == 3 else "S1"](840, poses, 1, 0)
    certified = Passport.of_radius(times * drawn.stated.r_mm, 0.05)
    result = calibrate(views_of(drawn), CalibrationOptions(passport=certified))
    assert abs(result.camera.fx - drawn.camera.values["fx"]) < result.U["fx"]


@pytest.mark.slow
def test_a_certificate_of_the_seen_length_is_doubted_if_the_camera_sees_another():
    assert at_fault(solved(FOCAL_MM, "seen")) > 0.5
    assert at_fault(solved(FOCAL_MM, "focal_length")) < 0.1


@pytest.mark.parametrize("times", first_quick([1.03, 1.0]))
def test_a_certificate_that_only_larger_errors_of_the_bench_explain_is_named(times):
    """Before, the stars seemed to contradict it by 2 sigma: parallax took up the 3 %, and fx was 25 U wrong."""
    drawn = draw_bench("like-bench", THREE, 1)
    certified = Passport.of_radius(times * drawn.truth.collimator.r, 0.05, length="seen")
    result = calibrate(drawn.views, CalibrationOptions(passport=certified))
    named = [note for note in result.notes if CERTIFICATE in note]
    assert bool(named) == (times != 1.0)
    assert named or abs(result.camera.fx - drawn.truth.camera.fx) < result.U["fx"]


def test_a_focal_length_determines_the_camera_where_focus_and_pupil_are_stated():
    options = CalibrationOptions(
        passport=Passport.of_radius(FOCAL_MM, 0.05, length="focal_length"),
        focus=TargetFocus((DEFOCUS, 0.002), (TO_FOCUS_MM, 2.0)),
    )
    result = calibrate(NARROW.views(np.random.default_rng(71), 0.05), options)
    assert abs(result.camera.fx - BENCH.fx) < result.U["fx"]
    # 60 mm x .002 and .05 x 2 mm of the pupil, beside .05 mm of the certificate: .164 mm of 255
    assert result.sigma["r"] == pytest.approx(0.164, rel=0.15)  # and the tails of a statement


@pytest.mark.parametrize(
    ("focus", "expected"),
    [
        (TargetFocus((0.05, 0.0), (-60.0, 0.0)), (-3.0, 0.0)),
        (TargetFocus((0.0, 0.01), (100.0, 0.0)), (0.0, 1.0)),
        (TargetFocus((0.0, 0.0)), (0.0, 0.0)),  # in focus: whatever the pupil's place
        (TargetFocus((0.1, 0.0)), (0.0, 0.1 * 250.0 / np.sqrt(3.0))),
    ],
)
def test_the_seen_length_differs_by_defocus_times_the_pupils_distance_from_the_focal_plane(focus, expected):
    assert focus.seen_less_focal_mm(250.0) == pytest.approx(expected)


def test_a_passport_keeps_which_length_its_certificate_states():
    made = Passport.of_radius(255.0, 0.05, length="focal_length")
    assert Passport.from_dict(made.to_dict()).length == "focal_length"
    assert "length" not in Passport.of_radius(255.0, 0.05).to_dict()


@pytest.mark.parametrize(
    "make",
    [
        lambda: Passport.of_radius(255.0, 0.05, length="effective"),
        lambda: Passport.from_dict(Passport.of_radius(255.0, 0.05).to_dict() | {"length": "long"}),
        lambda: TargetFocus(defocus=(0.0, -1.0)),
        lambda: TargetFocus(pupil_to_focus_mm=(np.nan, 1.0)),
    ],
)
def test_an_unknown_length_or_a_place_that_is_no_number_is_refused(make):
    with pytest.raises(InputMismatch):
        make()


def test_the_other_length_counts_as_much_where_other_amplitudes_are_more_probable_than_those_of_the_search():
    """Another length was left out there: it was weighed against the amplitudes of the search, 370 times less probable."""
    options = CalibrationOptions(passport=Passport.of_radius(FOCAL_MM, 0.05))
    modes = modes_of(adjust(NARROW.views(np.random.default_rng(71), 0.05), options))
    layout = modes.optimum.marginal.problem.bench.layout
    aside = np.zeros(len(layout.names))
    aside[layout.places(("fx", "fy"))] = 0.02 * modes.optimum.state.shared[0]

    def moved(node):
        return replace(node, solution=replace(node.solution, step=node.solution.step + aside))

    first, *doubts = modes.nodes
    better = replace(
        modes,
        nodes=[replace(first, weight=first.weight / 370.0), *map(moved, (first, *doubts))],
        scale=modes.scale + np.log(370.0),
    )
    share = posterior(modes).share_of((CERTIFICATE, FOCAL))
    assert share > 0.1
    assert posterior(better).share_of((CERTIFICATE, FOCAL)) == pytest.approx(share, rel=0.05)
