"""The collimators by name: how their discs behave on a gimbal."""

from dataclasses import replace

import numpy as np
from apparent import apparent_points

from simulators.optics.collimator_errors import disc_of, radius_fraction
from simulators.optics.picture import projection_of, true_rotation
from simulators.world.truth import COLLIMATORS, CollimatorTruth, Truth

POSES = [{"pan": pan, "tilt": tilt} for pan in (-6.0, 0.0, 6.0) for tilt in (-4.0, 0.0, 4.0)]


def discs(name):
    truth = Truth(collimator=COLLIMATORS[name])
    return [disc_of(truth.collimator, true_rotation(pose, truth)) for pose in POSES]


def test_the_edge_of_a_bench_is_the_same_in_every_pose_and_moves_against_the_pupil():
    first, *others = discs("like-bench")
    axes = [true_rotation(pose, Truth())[2] for pose in POSES]
    for disc, axis in zip(others, axes[1:], strict=True):
        np.testing.assert_array_equal(disc.edge, first.edge)
        assert disc.radius == first.radius
        tangents = axis[:2] / axis[2] - axes[0][:2] / axes[0][2]
        # 2 mm in front of the pivot, the pupil moves by 2 mm per unit tangent; wander adds .05 mm rms in each pose
        np.testing.assert_allclose(np.subtract(disc[:2], first[:2]), -2.0 * tangents, atol=0.4)
    assert np.std(first.edge) > 0.0


def test_the_random_displacements_of_a_bench_belong_to_the_reticle_and_not_to_the_pose():
    glass = replace(COLLIMATORS["like-bench"], disc_walk=(0.0, 0.0), disc_wander_mm=0.0, irregularity_mm=0.05)
    points = np.random.default_rng(2).uniform([60.0, 100.0], [140.0, 180.0], (50, 2))

    def seen(collimator, pose):
        truth = Truth(collimator=collimator)
        return apparent_points(points, projection_of(truth, true_rotation(pose, truth)).aberrations)

    here, there = (seen(glass, pose) for pose in (POSES[0], POSES[-1]))
    np.testing.assert_array_equal(here, there)
    here, there = (seen(replace(glass, glass_change=1.0), pose) for pose in (POSES[0], POSES[-1]))
    assert np.abs(here - there).max() > 0.01


def test_glass_change_sets_how_far_one_must_turn_to_see_other_glass():
    plain = CollimatorTruth(disc_unevenness=0.05)
    fast = replace(plain, glass_change=2.0)

    def rotation(tangent):
        axis = np.array([tangent, 0.0, 1.0]) / np.hypot(tangent, 1.0)
        return np.array([[axis[2], 0.0, -axis[0]], [0.0, 1.0, 0.0], axis])

    there, here = disc_of(fast, rotation(0.05)), disc_of(plain, rotation(0.1))
    np.testing.assert_allclose(there.edge, here.edge, atol=1e-12)
    around = np.array([[plain.x + 50.0, plain.y], [plain.x, plain.y + 50.0]])
    still = disc_of(replace(plain, glass_change=0.0), rotation(0.1))
    np.testing.assert_array_equal(
        radius_fraction(*around.T, still), radius_fraction(*around.T, disc_of(plain, rotation(0.0)))
    )
