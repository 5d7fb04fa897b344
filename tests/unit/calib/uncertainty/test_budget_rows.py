"""Rows of the uncertainty budget, their sums, and what is not included."""

import numpy as np
import pytest

from calib.engine import CalibrationOptions
from calib.fit import fit_model
from calib.model.budget_row import ROW_QUANTITIES, WORST_CORNER
from calib.model.gimbal_readings import GimbalReadings, ParallaxBound
from calib.model.passport import Passport
from calib.model.type_b_terms import TypeBTerm
from calib.uncertainty.budget_parts import covariance_parts
from calib.uncertainty.budget_rows import budget_rows, not_included, uncertainty_budget
from calib.uncertainty.projection_uncertainty import projection_uncertainty
from tests.support.drawn_benches import NINE, draw_bench

CERTIFICATE = Passport.of_radius(255.0, 0.05)
SCALE = TypeBTerm("scale of the print", "print_scale", 20e-6, "drawing 4711", "rectangular")
BOW = TypeBTerm("bow", "print_bow", 0.01, "maker", "triangular", radius_mm=40.0)
WAVES = TypeBTerm("wavefront", "wavefront", 5.0, "interferometer")


def fitted(bench, model="spherical", passport=None):
    options = CalibrationOptions(loss="l2", model=model, passport=passport)
    return fit_model(bench.views(np.random.default_rng(31), 0.02), options, model)


def budget_of(fit, terms):
    budget = uncertainty_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, terms)
    return budget.applied, budget.rows


@pytest.mark.parametrize("passport", [None, CERTIFICATE], ids=["free", "certificate"])
@pytest.mark.parametrize("model", ["spherical", "radial"])
def test_the_squares_of_the_contributions_add_up_to_those_of_the_result(bench, model, passport):
    fit = fitted(bench, model, passport)
    applied, rows = budget_of(fit, [SCALE, BOW, WAVES])
    names, covariance = list(applied.uncertainty.names), applied.uncertainty.covariance
    at = [names.index(name) for name in fit.parameters.camera.parameter_names]
    sigmas = {name: covariance[names.index(name), names.index(name)] ** 0.5 for name in ROW_QUANTITIES[:4]}
    sigmas[WORST_CORNER] = projection_uncertainty(fit.parameters.camera, covariance[np.ix_(at, at)]).worst_px
    for name, sigma in sigmas.items():
        assert np.linalg.norm([row.contribution[name] for row in rows]) == pytest.approx(sigma, rel=1e-4)
        assert sum(row.share[name] for row in rows) == pytest.approx(1, rel=1e-4)


def test_a_row_holds_value_divisor_sensitivity_and_contribution(bench):
    _, rows = budget_of(fitted(bench, passport=CERTIFICATE), [SCALE, BOW, WAVES])
    by_name = {row.name: row for row in rows}
    scale = by_name["scale of the print"]
    assert (scale.type, scale.value, scale.distribution, scale.source) == (
        "B",
        20e-6,
        "rectangular",
        "drawing 4711",
    )
    assert scale.divisor == pytest.approx(3**0.5)
    assert scale.sensitivity["fx"] == pytest.approx(3345, rel=0.02)
    for row in (scale, by_name["bow"], by_name["wavefront"], by_name["passport of the collimator"]):
        for name in ROW_QUANTITIES:
            expected = row.value / row.divisor * abs(row.sensitivity[name])
            # The corner of a split covariance is that of the total; its parts are scaled to add up.
            assert row.contribution[name] == pytest.approx(expected, rel=0.02, abs=1e-6)
    assert by_name["bow"].unit == "mm at 40 mm"
    assert by_name["passport of the collimator"].value == pytest.approx(0.05)
    assert (by_name["stars"].type, by_name["stars"].sensitivity) == ("A", {})


def test_the_source_of_a_row_can_be_named(bench):
    fit = fitted(bench, passport=CERTIFICATE)
    applied, _ = budget_of(fit, [])
    parts = covariance_parts(fit.bundle, fit.parameters, fit.loss, fit.uncertainty)
    rows = budget_rows(
        fit.parameters.camera, applied, parts, {"passport of the collimator": "certificate 12-3"}
    )
    assert [row.source for row in rows if row.name == "passport of the collimator"] == ["certificate 12-3"]


def test_what_nobody_stated_is_named_with_its_effect_on_these_views(bench, make_bench):
    applied, _ = budget_of(fitted(bench), [SCALE])
    camera = fitted(bench).parameters.camera
    lines = not_included(camera, applied)
    assert [line.split(":")[0] for line in lines] == [
        "bow of the print",
        "thermal expansion of the print",
        "slopes of the collimator's wavefront",
    ]
    assert "would move fx by" in lines[0]
    assert "less than 0.005 px" in lines[1]
    narrow, _ = budget_of(fitted(make_bench(half_angle_deg=5)), [SCALE])
    assert not_included(camera, narrow)[0] != lines[0]


def test_with_a_certificate_its_own_sources_are_asked_for(bench):
    fit = fitted(bench, passport=CERTIFICATE)
    applied, rows = budget_of(fit, [])
    assert rows[-1].name == "effective radius"
    assert rows[-1].contribution["fx"] == pytest.approx(2.0, rel=0.03)
    lines = not_included(fit.parameters.camera, applied)
    assert any(line.startswith("thermal expansion of the collimator since its certificate") for line in lines)
    assert not any("over the beam" in line for line in lines)


def test_a_stated_term_without_effect_is_named(bench):
    effective = TypeBTerm("effective radius", "effective_radius", 6e-4, "simulation")
    fit = fitted(bench)
    applied, rows = budget_of(fit, [effective])
    assert "effective radius" not in [row.name for row in rows]
    assert "has no effect" in not_included(fit.parameters.camera, applied)[-1]


def read_fit(bench, views, readings_deg):
    parallax = ParallaxBound(0.0, 0.005, 0.0, 0.5)
    readings = GimbalReadings(tuple(readings_deg), 0.002, 1e-4, 0.002, parallax, "certificate G-1")
    options = CalibrationOptions(loss="l2", gimbal=readings)
    return fit_model(views, options, "spherical")


def test_the_row_of_the_readings_is_what_their_scatter_does_to_refits(make_bench):
    poses = ((-5, 2), (0.5, -2.5), (5, 2.5), (-3, -3), (4, -1))
    bench, rng = make_bench(half_angle_deg=8, poses=poses), np.random.default_rng(3)
    views = bench.views(rng, 0.02)
    angles = [
        dict(
            zip(
                ("pan_deg", "tilt_deg", "roll_deg"),
                (*pose, 0.0) + 0.002 * rng.standard_normal(3),
                strict=True,
            )
        )
        for pose in poses
    ]
    fit = read_fit(bench, views, angles)
    _, rows = budget_of(fit, [])
    by_name = {row.name: row for row in rows}
    assert {"stars", "readings of the gimbal", "parallax", "scale and eccentricity of the gimbal"} <= set(
        by_name
    )
    squares = 0.0
    for view in range(len(poses)):
        for axis in angles[view]:
            moved = [dict(reading) for reading in angles]
            moved[view][axis] += 0.001
            away = read_fit(bench, views, moved).parameters.camera.fx - fit.parameters.camera.fx
            squares += (away / 0.001 * 0.002) ** 2
    assert by_name["readings of the gimbal"].contribution["fx"] == pytest.approx(squares**0.5, rel=0.02)
    whole = fit.uncertainty.covariance[0, 0] ** 0.5
    assert np.linalg.norm([row.contribution["fx"] for row in rows]) == pytest.approx(whole, rel=1e-6)


def test_a_planar_model_has_a_budget_too(bench):
    fit = fitted(bench, "planar")
    _, rows = budget_of(fit, [SCALE, BOW, WAVES])
    assert rows[0].name == "stars"
    assert all(np.isfinite(list(row.contribution.values())).all() for row in rows)
    assert {row.name: row for row in rows}["wavefront"].contribution["fx"] > 0


def test_one_view_with_a_certificate_has_a_budget(bench):
    views = bench.views(np.random.default_rng(31), 0.02)[:1]
    fit = fit_model(views, CalibrationOptions(loss="l2", passport=CERTIFICATE), "spherical")
    _, rows = budget_of(fit, [SCALE])
    assert {row.name: row for row in rows}["effective radius"].contribution["fx"] == pytest.approx(
        2, rel=0.05
    )


def test_the_squares_add_up_where_a_parameter_is_enlarged():
    """The principal point of inconsistent views has fewer degrees of freedom than the focal length."""
    fit = fit_model(
        draw_bench("like-bench", NINE, 1).views, CalibrationOptions(passport=CERTIFICATE), "radial"
    )
    applied, rows = budget_of(fit, [SCALE])
    names = list(applied.uncertainty.names)
    enlarged = applied.without_terms.covariance / fit.uncertainty.covariance
    assert enlarged[names.index("cx"), names.index("cx")] > 1.05
    for name in ROW_QUANTITIES[:4]:
        at = names.index(name)
        sigma = applied.uncertainty.covariance[at, at] ** 0.5
        assert np.linalg.norm([row.contribution[name] for row in rows]) == pytest.approx(sigma, rel=1e-4)
        assert sum(row.share[name] for row in rows) == pytest.approx(1, rel=1e-4)
