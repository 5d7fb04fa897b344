"""The places of a pupil that is moved by hand: how they are found, and what they add to the uncertainty."""

from dataclasses import replace

import numpy as np
import pytest
from slow_cases import slow

from calib import CalibrationOptions, Passport, calibrate
from calib.joint import amplitudes as amp
from calib.joint.adjust import adjust
from calib.joint.budget import variances
from calib.joint.knowledge import ASPECT, WRONG
from calib.joint.marginal import Marginal
from calib.joint.modes import modes_of
from calib.joint.places import spread_of_places, step_to_places
from calib.joint.posterior import posterior
from calib.joint.solve import search_with_fault
from calib.model.gimbal_readings import GimbalReadings
from calib.model.result_parts import PUPILS
from tests.benchmarks.worlds.catalogue import WORLDS
from tests.benchmarks.worlds.knowledge import views_of
from tests.support.drawn_benches import NINE, THREE, draw_bench
from tests.unit.calib.conftest import over_u


@pytest.fixture(scope="module")
def optimum():
    """The adjustment of nine poses of a mount that is moved by hand."""
    bench = WORLDS["S1"](3, 9, 1, 0)
    return adjust(views_of(bench), CalibrationOptions("joint"))


def with_pupils(optimum, places):
    """Return the equations at the optimum with the pupils elsewhere."""
    marginal = optimum.marginal
    problem = replace(marginal.problem, bench=replace(marginal.problem.bench, pupils=places))
    equations = problem.bench.linearised(optimum.state, 1.0, marginal.equations)
    return Marginal(problem, equations, optimum.state)


def doubt(optimum, places):
    """Return -2 log of the probability of places, with all other unknowns integrated out."""
    return with_pupils(optimum, places).solve(optimum.eta).value


def test_places_are_the_most_probable_ones_with_all_else_integrated_out(optimum):
    at, size = optimum.marginal.problem.bench.pupils, 1e-3
    sigma = np.sqrt(np.diag(np.linalg.inv(optimum.marginal.problem.pupils.information))).reshape(at.shape)
    steps = [size * sigma * np.eye(at.size)[k].reshape(at.shape) for k in range(at.size)]
    slopes = [(doubt(optimum, at + step) - doubt(optimum, at - step)) / (2.0 * size) for step in steps]
    assert np.abs(slopes).max() < 0.2  # for a change by 1 sigma of what the discs say


def test_an_optimum_by_the_state_of_a_fault_has_the_places_of_that_state(optimum):
    """With the places of the start, residuals were as large as these are far away."""
    problem, state = optimum.marginal.problem, optimum.state
    moved = replace(problem, bench=replace(problem.bench, pupils=problem.bench.pupils + 0.01))
    there = search_with_fault(moved, state, ((ASPECT, WRONG),))
    assert there.converged
    assert there.marginal.problem.faults == problem.faults
    spread = np.median(there.marginal.problem.bench.whitened(there.state))
    assert spread == pytest.approx(np.median(problem.bench.whitened(state)), rel=0.05)


def test_own_fields_share_their_amplitudes_with_what_follows_the_turn(optimum):
    """The gradient of the likelihood counts both."""
    marginal, hyper, step = optimum.marginal, optimum.marginal.problem.hyper, 1e-4
    gradient = marginal.solve(optimum.eta).gradient
    for k in hyper.places(amp.POSE):
        ahead, behind = (
            marginal.solve(optimum.eta + s * np.eye(len(gradient))[k]).value for s in (step, -step)
        )
        assert gradient[k] == pytest.approx((ahead - behind) / (2.0 * step), rel=1e-4, abs=1e-3)
    assert set(hyper.places(amp.POSE[:2])) < set(marginal.problem.random.amplitudes)


def test_prior_information_is_the_inverse_of_the_covariance(optimum):
    random, squares = optimum.marginal.problem.random, np.exp(2.0 * optimum.eta)
    shapes = random.shapes * np.sqrt(squares[random.amplitudes])
    covariance = shapes @ shapes.T + np.diag(random.stated)
    information, logarithm = random.information(squares)
    assert np.abs(information @ covariance - np.eye(len(covariance))).max() < 1e-6
    assert logarithm == pytest.approx(np.linalg.slogdet(covariance)[1], rel=1e-9)


def test_places_elsewhere_come_back(optimum):
    at = optimum.marginal.problem.bench.pupils
    moved = at + 0.02 * np.random.default_rng(1).normal(size=at.shape)
    marginal = with_pupils(optimum, moved)
    back = moved + step_to_places(marginal.solve(optimum.eta))
    assert doubt(optimum, back) < doubt(optimum, moved) - 1.0
    assert np.abs(back - at).max() < 0.1 * np.abs(moved - at).max()


def test_places_of_the_pupil_are_a_row_of_the_budget_which_adds_up(optimum):
    mixture = posterior(modes_of(optimum))
    at = optimum.marginal.problem.bench.layout.places(["fx", "cx", "r"])
    parts = variances(mixture, np.eye(len(mixture.mean))[at])
    assert sum(parts.values()) == pytest.approx(np.diag(mixture.covariance)[at], rel=1e-6)
    assert (parts[PUPILS] > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [(9, 17), slow((9, 17, 36, 38))])
def test_a_rim_that_differs_from_pose_to_pose_does_not_move_the_camera(seeds):
    """Short arcs show the middles of the discs to millimetres only; what the rim does bends about them."""
    over, options = [], CalibrationOptions(passport=Passport.of_radius(255.0, 0.05, length="seen"))
    for seed in seeds:
        bench = draw_bench("like-real", NINE, seed)
        result = calibrate(bench.views, options)
        # the certificate is right; 2 u counts a doubt of 2 % with its whole distance
        assert result.U["fx"] < 9.0
        assert max(result.U["cx"], result.U["cy"]) < 15.0
        over += over_u(result, vars(bench.truth.camera), ("fx", "cx", "cy"))
    assert max(over) < 1.6
    assert sum(share > 1.0 for share in over) <= 1


@pytest.mark.slow
def test_readings_beside_visible_discs_of_a_mount_moved_by_hand_give_a_covariance():
    bench = draw_bench("S1", THREE, 202)
    readings = GimbalReadings(tuple(bench.readings_deg), 0.002, 2e-4, source="drawn")
    known = CalibrationOptions(passport=Passport.of_radius(255.0, 0.05, length="seen"), gimbal=readings)
    result = calibrate(bench.views, known)
    assert np.linalg.eigvalsh(result.correlation).min() > 0.0


@pytest.mark.slow
def test_a_search_with_a_rim_about_middles_that_are_hardly_shown_ends():
    """Rim and middle multiply each other: steps that do not bend with them take ever smaller shares."""
    bench = WORLDS["S2"](14, 9, 1, 0)
    result = calibrate(views_of(bench), CalibrationOptions())
    assert result.iterations < 40
    assert result.camera.fx == pytest.approx(bench.camera.values["fx"], rel=0.02)


def test_pupils_that_are_known_exactly_add_nothing(optimum):
    marginal, solution = optimum.marginal, optimum.solution
    known = replace(marginal.problem.pupils, information=1e12 * marginal.problem.pupils.information)
    problem = replace(marginal.problem, pupils=known)
    exact = Marginal(problem, marginal.equations, marginal.state)
    spread = spread_of_places(replace(solution, marginal=exact))
    assert np.diag(spread).max() < 1e-6 * np.diag(solution.covariance).max()


def test_stars_bind_pupils_that_discs_hardly_show(optimum):
    marginal, pupils = optimum.marginal, optimum.marginal.problem.pupils
    sigmas = []
    for share in (1.0, 1e-6):
        problem = replace(marginal.problem, pupils=replace(pupils, information=share * pupils.information))
        poor = Marginal(problem, marginal.equations, marginal.state)
        sigmas.append(np.sqrt(np.diag(spread_of_places(replace(optimum.solution, marginal=poor)))[:4]))
    assert (sigmas[1] > sigmas[0]).all()
    assert (sigmas[1] < 30.0 * sigmas[0]).all()  # 1000 times by the discs alone


def test_spread_is_how_far_the_camera_moves_with_the_pupils(optimum):
    marginal, solution = optimum.marginal, optimum.solution
    step, n = 1e-4, marginal.problem.bench.n_poses
    moves = []
    for k in range(2 * n):
        ahead, behind = (
            with_pupils(
                optimum, marginal.problem.bench.pupils + sign * step * np.eye(2 * n)[k].reshape(n, 2)
            ).solve(optimum.eta)
            for sign in (1.0, -1.0)
        )
        moves.append((ahead.step - behind.step) / (2.0 * step))
    tight = 1e4 * marginal.problem.pupils.information  # so that the stars add nothing to what the discs say
    problem = replace(marginal.problem, pupils=replace(marginal.problem.pupils, information=tight))
    tightened = Marginal(problem, marginal.equations, marginal.state)
    spread = spread_of_places(replace(solution, marginal=tightened))
    expected = np.array(moves).T @ np.linalg.inv(tight) @ np.array(moves)
    camera = slice(0, 4)
    sigmas, theirs = (np.sqrt(np.diag(covariance)[camera]) for covariance in (spread, expected))
    assert sigmas == pytest.approx(theirs, rel=0.25)  # residuals bend what the differences see


@pytest.mark.slow
def test_places_before_fields_that_are_zero_but_hardly_known_move_the_camera_too(optimum):
    """On average over such fields as far as places move it with fields that are known."""
    marginal, columns = optimum.marginal, optimum.marginal.problem.bench.layout.by_turn.columns
    pupils = marginal.problem.pupils
    tight = replace(pupils, information=1e4 * pupils.information)  # the stars say nothing of the places
    problem = replace(marginal.problem, pupils=tight)
    still = replace(optimum.solution, step=np.zeros_like(optimum.solution.step))
    errors = np.linalg.cholesky(still.covariance[columns[:, None], columns])

    def variances_with(fields):
        shared = optimum.state.shared.copy()
        shared[columns] = fields
        there = Marginal(problem, marginal.equations, replace(optimum.state, shared=shared))
        return np.diag(spread_of_places(replace(still, marginal=there)))[:4]

    unseen, rng = variances_with(0.0), np.random.default_rng(1)
    drawn = [variances_with(errors @ rng.standard_normal(len(columns))) - unseen for _ in range(100)]
    assert np.mean(drawn, axis=0) == pytest.approx(unseen, rel=0.3)
