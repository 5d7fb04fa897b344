"""The worlds that judge the engine are what they claim to be."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import calib
from tests.benchmarks.worlds import (
    attacks,
    bound,
    catalogue,
    geometry,
    judge,
    lens_system,
    polynomial,
    product,
    ray_traced,
)
from tests.benchmarks.worlds.bench import NINE, THREE
from tests.benchmarks.worlds.knowledge import Answer, views_of


def without_noise(world):
    glass = replace(world.glass, print_scale=np.zeros(2))
    gimbal = replace(world.gimbal, scales=np.ones(2), squareness=0.0, eccentricity_deg=0.0, wobble_deg=0.0)
    return replace(world, glass=glass, gimbal=gimbal, star_px=0.0, pose_field_px=0.0, bad_share=0.0)


def test_the_worlds_print_has_the_ids_and_positions_of_the_target():
    ids, mm = geometry.printed_stars()
    target = calib.StarTarget()
    assert ids.tolist() == target.ids.tolist()
    assert mm == pytest.approx(target.positions_mm(ids), abs=1e-9)


def test_an_ideal_collimator_is_a_pinhole_before_a_sphere_as_opencv_projects_it():
    world = without_noise(polynomial.draw_world(5, "ideal"))
    values = {**world.camera.values, "p1": 4e-4, "p2": -3e-4, "k3": 2.0}
    world = replace(world, camera=replace(world.camera, values=values))
    for view, (pan, tilt) in zip(polynomial.record(world, 5, NINE).views, NINE, strict=True):
        rotation = world.gimbal.rotation(np.array([pan, tilt]), _noise(5, (pan, tilt)))
        foot = np.array([*world.glass.foot_mm, -world.glass.r])
        k = np.array([[values["fx"], 0, values["cx"]], [0, values["fy"], values["cy"]], [0, 0, 1]])
        lens = np.array([values[name] for name in ("k1", "k2", "p1", "p2", "k3")])
        solid = np.column_stack([view.mm, np.zeros(len(view.mm))])
        exact, _ = cv2.projectPoints(solid, cv2.Rodrigues(rotation)[0], -rotation @ foot, k, lens)
        assert len(view.ids) > 100
        assert np.abs(exact[:, 0] - view.px).max() < 1e-9


def _noise(seed, pose):
    lasting = np.random.default_rng((seed, 3, 0, *polynomial.pose_key(pose)))
    return 0.002 * lasting.normal(size=2)


def test_the_pattern_moves_against_a_camera_that_moves_before_a_collimator_out_of_focus():
    world = polynomial.draw_world(5, "ideal")
    glass = replace(world.glass, terms={**world.glass.terms, "defocus": 0.05}, print_scale=np.zeros(2))
    foot = glass.foot_mm[None]
    moved = np.array([2.0, -1.0])  # the camera across the beam, mm; the disc moves against it
    still, shifted = glass.seen_mm(foot, np.zeros(2))[0], glass.seen_mm(foot, -moved / glass.r)[0]
    assert shifted - still == pytest.approx(-0.05 * moved[None])


def test_what_a_pose_draws_does_not_depend_on_the_poses_beside_it_and_a_repeat_has_new_noise():
    world = polynomial.draw_world(6)
    few, many = (
        polynomial.record(world, 6, THREE[:2]),
        polynomial.record(world, 6, [NINE[4], *THREE], times=2),
    )
    assert few.views[1].px.tolist() == many.views[2].px.tolist()
    assert few.readings_deg[1] == many.readings_deg[2]
    again = many.views[6].px - many.views[2].px
    assert 0 < np.sqrt(np.mean(again**2)) < 0.1


def test_a_drawn_world_has_the_errors_that_it_states():
    certificates = []
    for seed in range(300):
        world = polynomial.draw_world(seed)
        certificates.append((world.stated.r_mm - world.glass.r) / world.stated.r_sigma_mm)
    assert np.std(certificates) == pytest.approx(1.0, abs=0.12)
    assert abs(np.mean(certificates)) < 0.2


@pytest.mark.parametrize("family", ["p1p2k3", "fisheye"])
def test_the_judges_corner_is_that_of_the_projection_map(family):
    camera = polynomial.draw_camera(np.random.default_rng(3), family)
    lens = {name: value for name, value in camera.values.items() if name not in judge.CENTRE}
    centre = [camera.values[name] for name in judge.CENTRE]
    model = calib.CameraModel(*centre, geometry.SIZE, lens)
    spread = np.random.default_rng(4).normal(size=(len(camera.values), len(camera.values)))
    sizes = np.diag([1.0 if name in judge.CENTRE else 1e-3 for name in model.parameter_names])
    covariance = sizes @ spread @ spread.T @ sizes
    values = {name: camera.values[name] for name in model.parameter_names}
    answer = Answer(values, covariance, 2.0, {}, (), "", 0.0, None, 0.0, None)
    error, sigma = judge.corner(answer, camera)
    mapped = calib.projection_uncertainty(model, covariance).sigma_px[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert sigma == pytest.approx(mapped.max(), rel=0.02)
    assert error == pytest.approx(0.0, abs=1e-6)
    turned = replace(camera, image_of=lambda rays: camera.project(rays @ geometry.turn([1e-4, 2e-4, 3e-4]).T))
    assert judge.corner(answer, turned)[0] == pytest.approx(0.0, abs=1e-3)


def thin_lens(focal, behind):
    """A lens of focal length `focal`, next to nothing thick, with the print so far behind it, and no bumps."""
    radius = 2 * focal * 0.5
    surfaces = (
        lens_system.Surface(-behind, radius, np.zeros(2), 1.0, 1.5),
        lens_system.Surface(-behind, -radius, np.zeros(2), 1.5, 1.0),
    )
    return lens_system.LensSystem(
        surfaces, lens_system.Bumps(np.zeros((1, 2)), np.ones(1), np.zeros(1)), np.zeros(2)
    )


def test_rays_through_a_thin_lens_meet_the_print_at_f_times_the_tangent():
    lens = thin_lens(255.0, 255.0)
    h = 1e-3 * np.array([[1.0, 0.0], [0.0, -1.0], [0.6, 0.8]])
    from_mm = np.tile([0.0, 0.0, -255.0 - 255.0], (3, 1))
    assert lens_system.focal_and_back_mm(lens.surfaces) == pytest.approx((255.0, 255.0))
    assert lens.print_mm(from_mm, h) == pytest.approx(255.0 * h, rel=1e-5)
    assert lens.tangents(from_mm, 255.0 * h, 255.0) == pytest.approx(h, rel=1e-5)


def test_a_print_behind_the_focus_looks_near_and_its_pattern_moves_as_a_point_at_that_distance():
    lens = thin_lens(255.0, 255.0 * 1.04)
    r, defocus = ray_traced.measured(lens, np.array([0.0, 0.0, -255.0 * 2.04]), half_angle_deg=0.2)
    assert r == pytest.approx(255.0, rel=1e-4)  # the pupil is in the front focus
    assert defocus == pytest.approx(-0.04, rel=1e-3)


def test_drawn_collimators_have_little_distortion_of_either_sign():
    distortions = []
    for seed in range(12):
        world = ray_traced.draw_world(seed)
        edge = np.array([[0.2, 0.0], [-0.2, 0.0]])
        at = world.lens.print_mm(np.tile(world.pupil_mm, (2, 1)), edge)
        distortions.append((at[0, 0] - at[1, 0]) / 0.4 / world.r - 1)
    assert max(map(abs, distortions)) < 0.012
    assert min(distortions) < -0.001 < 0.001 < max(distortions)


@pytest.mark.parametrize("family", ["k1k2", "p1p2k3", "fisheye"])
def test_a_lens_of_its_own_form_is_known_by_its_coefficients_to_a_hundredth_of_a_pixel(family):
    for seed in range(20):
        camera = ray_traced.draw_camera(np.random.default_rng(seed), family)
        px, _ = judge.sensor_points()
        rays = camera.rays(px)
        assert np.abs(camera.project(rays) - px).max() < 1e-6
        assert np.abs(geometry.by_names(camera.values, rays) - px).max() < 0.01


def test_the_products_world_draws_both_signs_of_each_error():
    glasses = [
        product.draw_glass(np.random.default_rng(seed), product.COLLIMATORS["like-bench"], 1.0)
        for seed in range(20)
    ]
    for name in product.ERRORS:
        values = [getattr(glass, name) for glass in glasses]
        assert min(values) < 0 < max(values)


@pytest.mark.parametrize("world", ["raytraced", "product", "S1"])
def test_the_same_seed_gives_the_same_bench(world):
    first, other = (catalogue.WORLDS[world](3, 3, 1, 0) for _ in range(2))
    assert [v.px.tolist() for v in first.views] == [v.px.tolist() for v in other.views]
    assert first.stated == other.stated
    assert min(len(v.ids) for v in first.views) > 40


def test_the_bound_is_what_an_adjustment_of_the_same_model_states_and_follows_what_is_known():
    world = polynomial.draw_world(5, "ideal")
    bench = polynomial.record(world, 5, NINE)
    calibration = calib.calibrate(views_of(bench), calib.CalibrationOptions(model="spherical", loss="l2"))
    least = {known: bound.bound_px(world, bench, known) for known in ("0", "c", "r", "cr")}
    for name in judge.CENTRE:
        stated = 2 * calibration.sigma[name] / np.sqrt(calibration.variance_factor)
        assert least["0"][name] == pytest.approx(stated, rel=0.03)
    assert least["cr"]["fx"] < min(least["c"]["fx"], least["r"]["fx"])
    flat = replace(bench, stated=replace(bench.stated, print_bow_mm=1e-6))
    assert bound.bound_px(world, flat, "cr")["fx"] < 0.7 * least["cr"]["fx"]


def test_every_attack_changes_what_the_engine_gets_and_nothing_else():
    world = polynomial.draw_world(0)
    honest_by = {}
    for name, attack in attacks.ATTACKS.items():
        poses = tuple(attack.poses), attack.times
        if poses not in honest_by:
            honest_by[poses] = polynomial.record(world, 0, *poses)
        honest = honest_by[poses]
        attacked = attack.bench(
            polynomial.record(attack.world(world), 0, attack.poses, attack.times, changed=attack.each_pose)
        )
        same = (
            attacked.stated == honest.stated
            and attacked.readings_deg == honest.readings_deg
            and attacked.facts == honest.facts
            and all(
                a.px.tolist() == b.px.tolist()
                and a.mm.tolist() == b.mm.tolist()
                and a.sigma_px[0] == b.sigma_px[0]
                for a, b in zip(attacked.views, honest.views, strict=False)
            )
            and len(attacked.views) == len(honest.views)
        )
        assert same == (attack.named_by == ""), name
        assert attacked.camera == honest.camera, name


def test_shifted_ids_are_those_of_the_neighbours():
    view = polynomial.record(polynomial.draw_world(0), 0, NINE).views[4]
    moved = attacks.shifted(view)
    kept = np.isin(view.px[:, 0], moved.px[:, 0])
    assert moved.mm == pytest.approx(view.mm[kept] + [geometry.PITCH_MM, 0.0])
    assert moved.mm == pytest.approx(calib.StarTarget().positions_mm(moved.ids))
