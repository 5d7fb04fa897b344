"""The effects of the joint adjustment: what each adds is what its own name says, whatever moves the pupil."""

import numpy as np
import pytest

from calib import CalibrationOptions
from calib.joint.adjust import adjust
from calib.joint.amplitudes import Lever, Pupil, hyperprior
from calib.joint.effects import EFFECTS
from calib.joint.effects.by_turn import Along, GimbalAside, OwnByTurn
from calib.joint.effects.camera import TurningErrors
from calib.joint.effects.collimator import COMMON_PLACES, FIELD, Changes, PoseFields
from calib.joint.effects.effect import Circumstances, PoseBasis, Turned
from calib.joint.effects.rim import NUMBER, Rim
from calib.joint.fields import FieldBasis
from calib.joint.layout import Layout
from calib.joint.prior import RandomPrior
from calib.joint.reported import as_seen
from calib.model.camera import CameraModel
from calib.model.gimbal_readings import GimbalReadings
from calib.model.rotation import exp_map
from calib.model.type_b_terms import TypeBTerm
from tests.support.drawn_benches import NINE, draw_bench
from tests.unit.calib.conftest import Bench

CAMERA = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
TURNS = np.array([[0.0, 0.0], [0.1, 0.02], [-0.05, 0.2]])
POSES = Turned(TURNS, np.tile(np.eye(2), (3, 1, 1)), TURNS)


def layout(pupil):
    bench = Circumstances(pupil, 1.0, 0.2, 0.2, len(TURNS), False, {}, gimbal=("scale_pan", "encoder_pan_0"))
    poses = PoseBasis(CAMERA, FieldBasis((0.0, 0.0, 250.0), 40.0), 0 if pupil is Pupil.HELD else NUMBER)
    return Layout(poses, bench)


@pytest.mark.parametrize("pupil", Pupil)
def test_every_unknown_belongs_to_one_effect_and_every_expected_size_to_one_unknown(pupil):
    there = layout(pupil)
    assert len(there.index) == len(there.names)
    prior = RandomPrior.of(there, hyperprior(Lever(0.03, 1.0), pupil))
    assert len(set(prior.places.tolist())) == len(prior.places)
    assert set(prior.groups) | set(there.own.rows) == set(there.rows)


@pytest.mark.parametrize("pupil", Pupil)
def test_an_effect_moves_the_image_by_its_own_unknowns_alone(pupil):
    there = layout(pupil)
    maps = there.maps(POSES)
    for kind in EFFECTS[pupil]:
        effect, at = kind(there.pose, there.bench), there.places(there.names_of(kind))
        alone = np.zeros((len(TURNS), there.pose.size, len(effect.names)))
        effect.fill(alone, POSES)
        assert np.array_equal(maps[:, :, at], alone)


def test_a_hand_brings_what_a_gimbal_has_not():
    held, walks, by_hand = map(layout, (Pupil.HELD, Pupil.WALKS, Pupil.BY_HAND))
    assert len(by_hand.names_of(Along)) == len(TURNS)
    assert by_hand.names_of(OwnByTurn)
    assert not by_hand.names_of(GimbalAside)
    assert not held.names_of(Rim)
    assert walks.names_of(Rim) == by_hand.names_of(Rim) != ()
    assert len(walks.own.places) == len(held.own.places) + NUMBER + 2


@pytest.mark.parametrize("lens", [("k1", "p1"), ("kb1",)])
def test_an_error_of_the_lens_moves_the_image_by_itself_however_far_the_camera_is_turned(lens):
    """Before, a thin prism of a fisheye lens counted up to twice at a turn of 35 degrees. That moved cy by 1.3 U."""
    rotations = exp_map(np.array([[0.0, 0.6, 0.0], [0.35, -0.3, 0.2]]))
    poses = Turned(rotations[:, 2, :2] / rotations[:, 2, 2:], rotations[:, :2, :2], np.zeros((2, 2)))
    basis, points = FieldBasis((0.0, 0.0, 250.0), 40.0), np.array([[0.0, 0.0, 250.0], [20.0, -25.0, 250.0]])
    effect = TurningErrors(PoseBasis(("fx", "fy", "cx", "cy", *lens), basis), layout(Pupil.HELD).bench)
    columns = np.zeros((2, effect.pose.size, len(effect.names)))
    effect.fill(columns, poses)
    camera = CameraModel(1e3, 1e3, 0.0, 0.0, (1280, 720), dict.fromkeys(lens, 0.0))
    for rotation, column in zip(rotations, columns[:, effect.pose.field, 0], strict=True):
        displaced = 0.25 * basis.polynomials(points[:, :2]) @ column.reshape(2, -1).T  # by 1e-3 of the radius
        before, after = (
            camera.project((points + far) @ rotation.T) for far in (0.0, np.pad(displaced, ((0, 0), (0, 1))))
        )
        prism = ((before / 1e3) ** 2).sum(axis=1)
        assert after - before == pytest.approx(np.column_stack([prism, 0.0 * prism]), rel=0.02, abs=0.01)


def test_the_stated_radius_is_the_length_that_a_camera_sees():
    """A glass that makes distances longer by 2 % is one whose camera sees a shorter length, and no other glass."""
    there = layout(Pupil.HELD)
    target = there.basis.polynomials(points := np.array([[5.0, -3.0], [30.0, 20.0], [-10.0, 35.0]]))
    found = np.zeros(len(there.names))
    found[there.index["r"]] = 250.0
    scale = 0.02 * there.basis.shape(np.asarray)[COMMON_PLACES]
    field = there.places([f"{FIELD}{k}" for k in COMMON_PLACES])
    found[field] = scale
    stated = as_seen(there, found) @ found
    displaced = np.zeros((2, target.shape[1]))
    displaced.reshape(-1)[COMMON_PLACES] = scale
    seen = (points + 250.0 * target @ displaced.T) / 250.0
    assert stated[there.index["r"]] == pytest.approx(250.0 * 0.98)
    assert points / stated[there.index["r"]] == pytest.approx(seen, rel=1e-3)  # to the square of the 2 %
    assert stated[field] == pytest.approx(0.0, abs=1e-15)
    found[field] = np.roll(scale, 1)  # all else stays as it is
    again = as_seen(there, found)
    assert again @ found == pytest.approx(again @ (again @ found))


@pytest.mark.parametrize("foot_mm", [(0.0, 0.0), (3.0, -2.0)])
def test_glass_whose_errors_grow_with_a_power_shows_the_length_on_its_axis(foot_mm):
    there = layout(Pupil.HELD)
    found = np.zeros(len(there.names))
    found[there.places(("x", "y", "r"))] = *foot_mm, 250.0
    off = np.array(foot_mm) / 250.0
    shape = there.basis.shape(lambda h: 30.0 * ((h - off) ** 2).sum(axis=1, keepdims=True) ** 3 * (h - off))
    found[there.places([f"{FIELD}{k}" for k in COMMON_PLACES])] = shape[COMMON_PLACES]
    stated = as_seen(there, found) @ found
    assert stated[there.index["r"]] == pytest.approx(250.0, abs=1e-4)


def test_on_some_drawn_bench_each_effect_is_told_from_all_others_together():
    """Ten times as large as expected, it stands out of the noise, though all others may imitate it.

    Changes since a passport move no star: a statement ties them to the collimator's unknowns.
    """
    rolled = [(pose["pan"], pose["tilt"], 60.0 * k) for k, pose in enumerate(NINE)]
    angles = tuple(dict(zip(("pan_deg", "tilt_deg", "roll_deg"), pose, strict=True)) for pose in rolled)
    stated = CalibrationOptions(
        gimbal=GimbalReadings(angles, 0.002, 2e-4, 0.001, None, "drawn"),
        budget=(TypeBTerm("bow", "print_bow", 0.5, "station", "rectangular", radius_mm=40.0),),
    )
    gimbal = adjust(Bench(half_angle_deg=40.0).views(np.random.default_rng(1), 0.003, rolled), stated)
    hand = adjust(draw_bench("like-real", NINE, 11, star_sigma_px=0.003).views, CalibrationOptions())
    told = {
        kind
        for optimum in (gimbal, hand)
        for kind in map(type, optimum.marginal.problem.bench.layout.effects)
        if 100.0 * (1.0 / left_unknown(optimum, kind) - 1.0) > 1.0
    }
    assert told == {kind for kinds in EFFECTS.values() for kind in kinds} - {Changes}


def left_unknown(optimum, kind):
    """The smallest share of an effect's variance that the views leave, of all combinations of its unknowns."""
    problem = optimum.marginal.problem
    solution = optimum.marginal.solve(problem.hyper.mean)
    names = problem.bench.layout.names_of(kind)
    if kind is PoseFields:
        return (solution.own_variances * problem.own_information(solution.squares)).min()
    if not names:
        return 1.0
    expected, random = problem.stated().information.copy(), problem.random.places
    expected[np.ix_(random, random)] += solution.inside
    own = np.ix_(*2 * [problem.bench.layout.places(names)])
    root = np.linalg.cholesky(expected[own])
    return np.linalg.eigvalsh(root.T @ solution.covariance[own] @ root)[0]
