"""The plain adjustment: its equations are those of its residuals, its likelihood has its gradient, its budget adds up."""

from dataclasses import replace

import numpy as np
import pytest

from calib.adjustment.parameters import AdjustmentParameters
from calib.calibration import CalibrationOptions
from calib.errors import DegenerateViews
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.type_b_terms import TypeBTerm
from tests.benchmarks.plain.adjust import adjusted
from tests.benchmarks.plain.equations import Equations
from tests.benchmarks.plain.explanations import explanations
from tests.benchmarks.plain.forecast import PredictedViews
from tests.benchmarks.plain.hypotheses import FOCAL, WRONG, hypotheses
from tests.benchmarks.plain.knowledge import CERTIFICATE
from tests.benchmarks.plain.problem import State
from tests.benchmarks.plain.result import calibrate_jointly
from tests.benchmarks.plain.solution import solve
from tests.benchmarks.plain.uncertainty import expanded
from tests.unit.calib.conftest import Bench

pytestmark = pytest.mark.slow  # a candidate that the product does not use

POSES = ((-5, 2), (0.5, -2.5, 10), (5, 2.5, -20), (0, 0, 45))
BENCH = Bench()


def readings(rng, poses=POSES):
    angles = tuple(
        dict(zip(("pan_deg", "tilt_deg", "roll_deg"), [*pose, 0.0][:3], strict=True)) for pose in poses
    )
    noisy = tuple({axis: value + 0.002 * rng.normal() for axis, value in angle.items()} for angle in angles)
    return GimbalReadings(noisy, 0.002, 2e-4, 0.002, ParallaxBound(0.0, 0.01, 0.0, 0.5), "test")


def options(rng):
    terms = (TypeBTerm("print scale", "print_scale", 2e-5, "drawing", "rectangular"),)
    return CalibrationOptions(
        passport=Passport.of_radius(255.0, 0.05), gimbal=readings(rng), budget=terms, passport_source="lab"
    )


@pytest.fixture(scope="module")
def stated():
    rng = np.random.default_rng(7)
    views = BENCH.views(rng, 0.05, poses=POSES)
    given = options(rng)
    return views, given, adjusted(views, given)[0]


def test_the_equations_are_the_slopes_of_the_residuals(stated):
    solution = stated[2].optimum.solution
    problem, weights = solution.problem, solution.equations.weights
    rng = np.random.default_rng(1)
    size = np.sqrt(problem.variances(problem.expected.mean, {}))
    state = stated[2].optimum.state
    bent = 0.1 * size * rng.normal(size=len(size))
    bent[:4] = 0.0
    state = State(state.b + np.where(size < 0.1, bent, 0.0), state.own, state.rotations)
    equations = Equations.at(problem, state, weights)

    def cost(b):
        lengths = problem.lengths(State(b, state.own, state.rotations))
        return sum(float(weight @ length**2) for weight, length in zip(weights.whole, lengths, strict=True))

    for k in rng.choice(len(size), 40, replace=False):
        step = 1e-4 * min(size[k], 1e-2) * np.eye(len(size))[k]
        slope = (cost(state.b + step) - cost(state.b - step)) / (2.0 * step[k])
        scale = 1e-3 * np.sqrt(equations.shared[k, k] * equations.cost)
        assert -2.0 * equations.shared_right[k] == pytest.approx(slope, rel=1e-2, abs=scale), k


def test_the_likelihood_has_its_gradient(stated):
    best = stated[2].optimum.solution
    for k in range(len(best.eta)):
        more, less = (solve(best.equations, best.eta + h * np.eye(len(best.eta))[k]) for h in (1e-4, -1e-4))
        assert best.gradient[k] == pytest.approx((more.value - less.value) / 2e-4, abs=2e-3), k


def test_a_calibration_covers_the_truth_and_its_budget_adds_up(stated):
    views, given, _ = stated
    result = calibrate_jointly(views, given, ())
    for name, true in BENCH.truth.items():
        if name in result.values:
            assert abs(result.values[name] - true) < 1.3 * result.U[name], name
    for name in ("fx", "cx", "r", "radial"):
        squares = sum(sigmas[name] ** 2 for sigmas in result.budget.values())
        assert squares == pytest.approx(result.sigma[name] ** 2, rel=1e-6)
    assert result.gimbal is not None
    assert result.gimbal.entered
    assert {CERTIFICATE, "scale of pan", "square pixels"} <= {witness.name for witness in result.witnesses}
    assert max(witness.fault_probability for witness in result.witnesses) < 0.2
    assert result.passport().values_by_name["r"] == pytest.approx(result.values["r"])
    assert result.left_out_rms_px == pytest.approx(0.07, rel=0.3)


def test_a_statement_can_be_wrong_or_larger_and_a_certificate_mean_the_focal_length(stated):
    found = hypotheses(stated[2].problem.unknowns)
    faults = {fault for one in found for name, fault in one.faults if name == CERTIFICATE}
    assert {WRONG, FOCAL, "3.16 times", "10 times"} <= faults
    alone = [one for one in found if one.faults == (("scale of pan", WRONG),)]
    together = [one for one in found if len(one.faults) == 3 and all(f == WRONG for _, f in one.faults)]
    assert len(alone) == len(together) == 1
    assert set(alone[0].wide) < set(together[0].wide)


def test_u_of_a_gaussian_is_twice_its_sigma_and_does_not_step():
    one, zero = np.array([1.0]), np.array([0.0])
    assert expanded(one, zero, np.array([3.0])) == pytest.approx(6.0, rel=1e-5)
    sizes = [
        expanded(np.array([1.0 - w, w]), np.array([0.0, 4.0]), np.array([1.0, 5.0]))
        for w in (0.02, 0.04, 0.05, 0.06)
    ]
    assert (np.diff(sizes) > 0.0).all()
    assert sizes[-1] < 1.6 * sizes[0]


def test_a_passport_calibrates_another_camera_from_one_view(stated):
    views, given, _ = stated
    passport = calibrate_jointly(views, given, ()).passport()
    other = replace(BENCH, fx=3400.0, fy=3401.0)
    view = other.views(np.random.default_rng(8), 0.05, poses=((1.0, -1.0),))
    mixture, _ = explanations(view, CalibrationOptions(passport=passport))
    at = mixture.places(("fx",))[0]
    u = mixture.expanded(np.eye(len(mixture.names))[at])
    assert abs(mixture.mean[at] - 3400.0) < 1.3 * u < 60.0


def test_a_forecast_tells_less_where_less_is_stated(stated):
    views, given, _ = stated
    result = calibrate_jointly(views, given, ())
    start = AdjustmentParameters(
        result.camera, result.collimator, result.rotations, np.zeros((len(views), 3))
    )
    with_all, alone = (PredictedViews(views, start, known) for known in (given, CalibrationOptions()))
    stated_fx, alone_fx = (
        np.sqrt(predicted.summary(predicted.hyper.mean).covariance[0, 0]) for predicted in (with_all, alone)
    )
    assert 0.3 < stated_fx / result.sigma["fx"] < 3.0
    assert alone_fx > 2.0 * stated_fx
    information = with_all.information(with_all.hyper.mean)
    whole = information.prior + sum(
        t.T @ own @ t for t, own in zip(information.maps, information.own, strict=True)
    )
    assert np.sqrt(np.linalg.inv(whole)[0, 0]) == pytest.approx(stated_fx, rel=0.3)


def test_views_of_one_turn_are_refused():
    views = BENCH.views(np.random.default_rng(9), 0.05, poses=((0.0, 0.0), (0.0, 0.0), (0.01, 0.0)))
    with pytest.raises(DegenerateViews):
        calibrate_jointly(views, CalibrationOptions(), ())
