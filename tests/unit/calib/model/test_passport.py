"""A collimator known beforehand."""

import json

import numpy as np
import pytest
from slow_cases import slow

from calib import CalibrationOptions, Passport, calibrate
from calib.errors import InputMismatch

EXACT = Passport(("x", "y", "r"), np.array([97.0, 140.1, 255.0]), np.diag([1e-4, 1e-4, 1e-4]) ** 2)


def with_passport(passport, **more):
    return CalibrationOptions(passport=passport, **more)


@pytest.mark.parametrize(("count", "limit"), [(1, 1.5), slow(3, 0.5)])
def test_an_exact_passport_settles_the_focal_length(make_bench, count, limit):
    bench = make_bench()
    views = bench.views(np.random.default_rng(61), 0.05)[:count]
    known = calibrate(views, with_passport(EXACT))
    assert known.sigma["fx"] < limit
    assert known.camera.fx == pytest.approx(bench.fx, abs=4 * known.sigma["fx"])


def test_the_passports_own_uncertainty_enters(bench):
    views = bench.views(np.random.default_rng(62), 0.05)
    loose = Passport(EXACT.names, EXACT.values, np.diag([0.01, 0.01, 0.1]) ** 2)
    sigma = calibrate(views, with_passport(loose)).sigma["fx"]
    # df / f = .98 dr / r, beside what the stars and another place of the pupil leave.
    stated = np.hypot(0.98 * 3345 * 0.1 / 255, 0.2)
    assert stated <= sigma < 1.2 * stated  # with the tails of a statement


def test_a_certificate_leaves_the_radial_terms_free(bench):
    views = bench.views(np.random.default_rng(63), 0.05)
    known = calibrate(views, with_passport(Passport.of_radius(255.0, 0.02, length="seen")))
    assert set(known.collimator.aberrations) == {"radial", "radial_4"}
    share = {row.name: row.contribution["fx"] for row in known.budget_rows}
    stated = 0.02 / 255.0 * bench.fx
    assert stated <= share["passport of the collimator"] < 1.4 * stated  # with the tails of a statement


def test_a_passport_made_from_views_calibrates_another_camera(make_bench, bench):
    certified = with_passport(Passport.of_radius(255.0, 0.05, length="seen"))
    first = calibrate(bench.views(np.random.default_rng(64), 0.02), certified)
    passport = first.passport({"temperature_c": 21.5})
    assert passport.names[:5] == ("x", "y", "r", "radial", "radial_4")
    assert passport.views == ("pose-001", "pose-002", "pose-003")
    other = make_bench(fx=2900.0, fy=2901.0, cx=650.0, cy=340.0, k=(-0.1, 0.2))
    result = calibrate(other.views(np.random.default_rng(65), 0.05)[:1], with_passport(passport))
    assert result.camera.fx == pytest.approx(2900.0, abs=4 * result.sigma["fx"])
    assert result.sigma["fx"] < 0.0015 * result.camera.fx
    assert result.collimator.r == pytest.approx(first.collimator.r, abs=2 * result.sigma["r"])


def test_passports_go_round_through_json():
    passport = Passport(
        ("x", "y", "r", "pupil_shift"),
        np.array([1.0, 2.0, 250.0, -0.1]),
        np.diag([0.1, 0.1, 0.2, 0.01]),
        (1.1, 2.2, 250.5),
        3.5,
        ("a", "b"),
        {"date": "2026-11-20"},
    )
    again = Passport.from_dict(json.loads(json.dumps(passport.to_dict())))
    assert again.to_dict() == passport.to_dict()
    assert again.values_by_name["pupil_shift"] == -0.1


@pytest.mark.parametrize(
    "change",
    [
        {"schema": "other"},
        {"values": [1.0]},
        {"covariance": [[1, 2], [2, 1]]},
        {"names": ["x", "y"]},
        {"values": [1.0, float("nan")]},
        {"reference": [1.0]},
        {"views": None},
        {"names": ["r", "radial"]},
    ],
)
def test_what_is_no_passport_is_refused(change):
    good = Passport(("x", "r"), np.array([1.0, 250.0]), np.eye(2)).to_dict()
    assert Passport.from_dict(good).names == ("x", "r")
    with pytest.raises(InputMismatch, match="passport"):
        Passport.from_dict({**good, **change})


def test_a_state_without_a_wrong_passport_that_cannot_be_found_is_no_crash(bench, monkeypatch):
    def without(*_):
        raise np.linalg.LinAlgError

    views = [
        view.part(np.arange(len(view)) % 4 == 0) for view in bench.views(np.random.default_rng(66), 0.02)
    ]
    wrong = Passport(EXACT.names, EXACT.values + 25.0 * np.eye(3)[2], np.diag([0.05, 0.05, 0.1]) ** 2)
    monkeypatch.setattr("calib.joint.posterior.optimum_with_faults", without)
    assert calibrate(views, with_passport(wrong)).camera.fx > 0.0
