"""Type B terms: their sensitivities against refits of data that were shifted by brute force."""

from dataclasses import replace

import numpy as np
import pytest

from calib.engine import CalibrationOptions
from calib.fit import fit_model
from calib.model.passport import Passport
from calib.model.type_b_terms import DEFAULT_EFFECTIVE_RADIUS, TypeBTerm
from calib.uncertainty.target_response import target_response
from calib.uncertainty.type_b import apply_budget, radius_difference_variance
from calib.view import View

#: So uncertain that no bow of these tests contradicts it.
CERTIFICATE = Passport.of_radius(255.0, 0.5)
OPTIONS = {
    "spherical": CalibrationOptions(loss="l2"),
    "radial": CalibrationOptions(loss="l2", model="radial"),
    "spherical with a certificate": CalibrationOptions(loss="l2", passport=CERTIFICATE),
    "radial with a certificate": CalibrationOptions(loss="l2", model="radial", passport=CERTIFICATE),
    "huber": CalibrationOptions(huber_px=0.05),
}
SCALE = TypeBTerm("scale of the print", "print_scale", 20e-6, "drawing", "rectangular")
BOW = TypeBTerm("bow of the print", "print_bow", 0.01, "drawing", "rectangular", radius_mm=40.0)
EXPANSION = TypeBTerm("expansion", "thermal", 1e-5, "glass")
EFFECTIVE = TypeBTerm("effective radius", "effective_radius", 6e-4, "simulation")


def displaced(term, size, bench):
    """Function that gives the true place of a star (X, Y, Z) under a term of that size."""

    def place(target_mm):
        if term.kind == "print_bow":
            height = size * ((target_mm - bench.centre[:2]) ** 2).sum(axis=1) / term.radius_mm**2
            return np.column_stack([target_mm, height])
        return np.column_stack([target_mm * (1.0 + size), np.zeros(len(target_mm))])

    return place


def views_of(bench, place=None, seed=5):
    """The views of a bench, with a target whose stars lie elsewhere; the noise is that of the seed."""
    views, rng = [], np.random.default_rng(seed)
    for view, turn in zip(bench.views(), bench.rotations, strict=True):
        camera = np.array([[bench.fx, 0, bench.cx], [0, bench.fy, bench.cy], [0, 0, 1.0]])
        world = (
            np.column_stack([view.target_mm, np.zeros(len(view))]) if place is None else place(view.target_mm)
        )
        points = (world - np.array(bench.centre)) @ turn.T
        x, y = (points[:, :2] / points[:, 2:]).T
        r2 = x**2 + y**2
        bend = 1 + bench.k[0] * r2 + bench.k[1] * r2**2
        pixels = np.column_stack([bend * x, bend * y, np.ones(len(x))]) @ camera.T
        found = pixels[:, :2] + 0.02 * rng.standard_normal((len(x), 2))
        views.append(View(view.name, view.image_size, view.ids, found, view.target_mm, view.covariances_px2))
    return views


def fitted(bench, how, place=None, *, seed=5, **other):
    options = OPTIONS[how] if not other else CalibrationOptions(**{**vars(OPTIONS[how]), **other})
    return fit_model(views_of(bench, place, seed), options, options.model)


def values(fit):
    return fit.parameters.values(fit.uncertainty.names)


def response_of(fit):
    return target_response(fit.bundle, fit.parameters, fit.loss, fit.uncertainty.names)


@pytest.mark.parametrize("how", OPTIONS)
@pytest.mark.parametrize(("term", "size"), [(SCALE, 1e-4), (BOW, 0.005)], ids=["scale", "bow"])
def test_the_response_is_that_of_a_refit_of_shifted_data(bench, how, term, size):
    at = fitted(bench, how)
    expected, turns = response_of(at).by_term(term)
    ahead, back = (fitted(bench, how, displaced(term, sign * size, bench)) for sign in (1, -1))
    found = (values(ahead) - values(back)) / (2 * size)
    sigmas = np.sqrt(np.diag(at.uncertainty.covariance))
    # The second term is what the steps of the refits leave: far below what any star could show.
    assert (np.abs(found - expected) <= 0.01 * np.abs(expected) + 0.02 * sigmas / size).all()
    turned = [
        (a @ b.T)[[2, 0, 1], [1, 2, 0]]
        for a, b in zip(ahead.parameters.rotations, back.parameters.rotations, strict=True)
    ]
    assert np.ravel(turned) / (2 * size) == pytest.approx(turns, rel=0.02, abs=2e-7 / size)


@pytest.mark.parametrize("how", ["spherical with a certificate", "radial with a certificate"])
def test_the_response_to_the_radius_is_that_of_a_refit_with_another_certificate(bench, how):
    at = fitted(bench, how)
    expected, _ = response_of(at).by_term(EFFECTIVE)
    ahead, back = (
        fitted(bench, how, passport=Passport.of_radius(255.0 * (1 + step), 0.5)) for step in (1e-4, -1e-4)
    )
    found = (values(ahead) - values(back)) / 2e-4
    assert found == pytest.approx(expected, rel=0.01, abs=0.05)
    assert dict(zip(at.uncertainty.names, expected, strict=True))["fx"] == pytest.approx(3345, rel=0.02)


def test_a_scale_moves_the_radius_if_it_is_free_and_the_focal_length_if_a_certificate_gives_it(bench):
    free = fitted(bench, "spherical")
    own = dict(zip(free.uncertainty.names, response_of(free).by_term(SCALE)[0], strict=True))
    assert own["fx"] == pytest.approx(0, abs=1e-3)
    assert own["r"] == pytest.approx(-255, rel=1e-3)
    held = fitted(bench, "spherical with a certificate")
    own = dict(zip(held.uncertainty.names, response_of(held).by_term(SCALE)[0], strict=True))
    assert own["r"] == 0
    assert own["fx"] == pytest.approx(3345, rel=0.02)


def test_a_radial_term_takes_up_a_bow(bench):
    by = {
        how: dict(
            zip((fit := fitted(bench, how)).uncertainty.names, response_of(fit).by_term(BOW)[0], strict=True)
        )["fx"]
        for how in ("spherical", "radial")
    }
    assert abs(by["radial"]) < 0.1 * abs(by["spherical"])


def test_terms_enter_covariance_budget_and_rotations(bench):
    fit = fitted(bench, "spherical with a certificate")
    terms = [SCALE, BOW, EXPANSION, TypeBTerm("wavefront", "wavefront", 2.0, "interferometer")]
    applied = apply_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, terms)
    total, before = applied.uncertainty, applied.without_terms
    assert (np.diag(before.covariance) >= (1 - 1e-12) * np.diag(fit.uncertainty.covariance)).all()
    assert np.allclose(total.covariance, before.covariance + sum(c.covariance for c in applied.contributions))
    assert np.allclose(sum(total.budget.values()), np.diag(total.covariance))
    assert list(total.budget) == [*before.budget, *(term.name for term in terms), "effective radius"]
    at = total.names.index("fx")
    assert total.budget["scale of the print"][at] == pytest.approx((3345 * 20e-6) ** 2 / 3, rel=0.05)
    assert total.budget["effective radius"][at] == pytest.approx(
        (3345 * DEFAULT_EFFECTIVE_RADIUS) ** 2, rel=0.05
    )
    assert total.budget["effective radius"][total.names.index("r")] == pytest.approx((255 * 6e-4) ** 2)
    assert (np.diag(applied.rotation_covariance) > 0).all()
    assert np.linalg.eigvalsh(total.covariance)[0] > 0


def test_a_wavefront_spreads_refits_as_its_covariance_says(bench):
    """Random fields drawn from their spectrum, with refits; the covariance is that of the refits."""
    term, rng = TypeBTerm("wavefront", "wavefront", 1.0, "x", correlation_mm=20.0), np.random.default_rng(8)
    at = fitted(bench, "spherical with a certificate")
    response = response_of(at)
    covariance = response.by_wavefront(term)[0]
    found, squares = [], []
    for _ in range(120):
        waves, phases = rng.standard_normal((300, 2)) / 20.0, rng.uniform(0, 2 * np.pi, 300)
        slopes = np.sin(response.stars_mm @ waves.T + phases) @ waves
        slopes -= slopes.mean(axis=0)
        squares.append((slopes**2).sum(axis=1).mean())
        found.append(np.einsum("gkm,mk->g", response.shared[:, :2], 255e-6 * slopes))
    spread = np.mean(np.square(found), axis=0) / np.mean(squares)
    free = [i for i, name in enumerate(at.uncertainty.names) if name != "r"]
    # The mean slope moves the free centre and nothing else that matters.
    compared = [i for i in free if at.uncertainty.names[i] not in ("x", "y")]
    assert np.sqrt(spread[compared] / np.diag(covariance)[compared]) == pytest.approx(1, rel=0.3)


def test_terms_of_a_certificate_say_nothing_where_views_determine_the_radius(bench):
    fit = fitted(bench, "spherical")
    applied = apply_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, [EFFECTIVE])
    assert not applied.contributions[0].applies
    assert list(applied.uncertainty.budget) == list(fit.uncertainty.budget)
    assert np.allclose(applied.uncertainty.covariance, fit.uncertainty.covariance)


def test_degrees_of_freedom_follow_welch_and_satterthwaite(bench):
    fit = fitted(bench, "spherical with a certificate")
    few = TypeBTerm("effective radius", "effective_radius", 0.05, "five tests", degrees_of_freedom=5.0)
    applied = apply_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, [few])
    own = dict(zip(fit.uncertainty.names, applied.degrees_of_freedom, strict=True))
    share = applied.uncertainty.budget["effective radius"] / np.diag(applied.uncertainty.covariance)
    at = fit.uncertainty.names.index("fx")
    assert own["fx"] == pytest.approx(5 / share[at] ** 2, rel=0.02)
    # A parameter with fewer degrees of freedom has a sigma that the common factor covers.
    grown = np.sqrt(np.diag(applied.without_terms.covariance) / np.diag(fit.uncertainty.covariance))
    assert (grown >= 1 - 1e-12).all()
    assert applied.uncertainty.effective_degrees_of_freedom == min(own["fx"], own["fy"])
    without = apply_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, [EFFECTIVE])
    assert without.degrees_of_freedom[at] > fit.uncertainty.effective_degrees_of_freedom


def test_a_bow_and_the_effective_radius_explain_a_radius_unlike_the_certificate(bench):
    fit = fitted(bench, "spherical")
    response = response_of(fit)
    alone = radius_difference_variance(response, [])
    assert alone**0.5 == pytest.approx(255 * DEFAULT_EFFECTIVE_RADIUS, rel=1e-2)
    exact = TypeBTerm("effective radius", "effective_radius", 0.0, "x")
    bowed = fitted(bench, "spherical", displaced(BOW, BOW.value, bench)).parameters.collimator.r
    stated = radius_difference_variance(response, [exact, BOW]) ** 0.5
    assert stated == pytest.approx(abs(bowed - fit.parameters.collimator.r) / 3**0.5, rel=0.05)
    waves = TypeBTerm("w", "wavefront", 2.0, "x")
    assert radius_difference_variance(response, [exact, waves]) > 0


@pytest.mark.parametrize("how", ["spherical", "radial with a certificate"])
def test_stated_terms_cover_what_they_do_to_whole_calibrations(make_bench, how):
    """Benches drawn from the stated terms: errors over sigmas are those of a normal distribution."""
    bench, rng = make_bench(half_angle_deg=8), np.random.default_rng(77)
    terms = [SCALE, BOW, TypeBTerm("effective radius", "effective_radius", 1e-3, "x")]
    found = []
    for seed in range(40):
        scale, bow = rng.uniform(-1, 1, 2) * (20e-6, 0.01)
        certified = 255.0 * (1 + 1e-3 * rng.standard_normal()) + 0.05 * rng.standard_normal()

        def place(target_mm, scale=scale, bow=bow):
            height = bow * ((target_mm - bench.centre[:2]) ** 2).sum(axis=1) / 40.0**2
            return np.column_stack([target_mm * (1 + scale), height])

        # The term of the effective radius is part of what the test of a certificate must allow for.
        certificate = {"passport": Passport.of_radius(certified, 0.05)} if "certificate" in how else {}
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("calib.fit.check_passport", lambda *_: None)
            fit = fitted(bench, how, place, seed=seed, **certificate)
        applied = apply_budget(fit.bundle, fit.parameters, fit.loss, fit.uncertainty, terms)
        sigma = applied.uncertainty.covariance[0, 0] ** 0.5
        found.append((fit.parameters.camera.fx - bench.fx) / sigma)
    assert 0.75 < np.sqrt(np.mean(np.square(found))) < 1.25
    assert np.mean(np.abs(found) < 2) > 0.85


def test_a_wavefront_on_a_lattice_of_stars_is_that_of_stars_anywhere(bench):
    """On a lattice the sums run over rows and columns; the smallest displacement of the stars takes the other way."""
    term, rng = TypeBTerm("wavefront", "wavefront", 1.0, "x", correlation_mm=20.0), np.random.default_rng(9)
    response = response_of(fitted(bench, "spherical with a certificate"))
    moved = replace(response, stars_mm=response.stars_mm + rng.uniform(-1e-9, 1e-9, response.stars_mm.shape))
    on_lattice, anywhere = response.by_wavefront(term), moved.by_wavefront(term)
    for found, expected in zip(on_lattice, anywhere, strict=True):
        assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()
    assert (response.shared_by_wavefront(term) == on_lattice[0]).all()
