"""In a notebook, results and views show themselves briefly, hold numbers by name, and cannot be changed from outside."""

import importlib
from dataclasses import replace
from operator import methodcaller

import numpy as np
import pytest

from calib import (
    CalibrationOptions,
    Passport,
    StarTarget,
    View,
    calibrate,
    detect_view,
    projection_uncertainty,
)
from calib.errors import CalibrationError, InputMismatch
from tests.support.exported_camera import calibration

N = 6


def view(**changed):
    given = {
        "ids": np.arange(N),
        "points_px": np.arange(2.0 * N).reshape(N, 2),
        "target_mm": np.arange(2.0 * N).reshape(N, 2),
        "covariances_px2": np.tile(0.04 * np.eye(2), (N, 1, 1)),
    }
    return View("left", **{"image_size": (640, 480), **given, **changed})


def test_one_number_of_px_is_the_sigma_of_every_point():
    assert np.allclose(view(covariances_px2=0.2).covariances_px2, view().covariances_px2, rtol=1e-12)
    for wrong in (0, -0.2, np.nan):
        with pytest.raises(InputMismatch):
            view(covariances_px2=wrong)


def test_a_view_without_covariances_says_how_to_give_them():
    whole = view()
    with pytest.raises(InputMismatch, match=r"covariances_px2.*one number"):
        View("left", whole.image_size, whole.ids, whole.points_px, whole.target_mm)


@pytest.mark.parametrize("name", ["ids", "points_px", "target_mm", "covariances_px2"])
def test_masked_stars_are_refused_instead_of_used(name):
    masked = np.ma.array(getattr(view(), name))
    view(**{name: masked})  # none of it is masked
    masked[1] = np.ma.masked
    with pytest.raises(InputMismatch, match=f"view left: Its {name} hold masked values.*without the rows"):
        view(**{name: masked})


def test_masked_pixels_are_refused_instead_of_used():
    with pytest.raises(InputMismatch, match=r"image holds masked values.*filled"):
        detect_view(np.ma.masked_less(np.ones((9, 9)), 2), StarTarget())


def np_arrays(value):
    return [part for part in (value if isinstance(value, list) else [value]) if isinstance(part, np.ndarray)]


@pytest.fixture
def result():
    return replace(calibration("k1k2"), coverage_factors={"fx": 2.1, "k1": 2.6}, notes=("a < b " * 60,) * 9)


def test_no_array_of_a_result_can_be_changed(result):
    whole = replace(result, residuals_px=[np.zeros((2, 2))], weights=[np.ones(2)])
    uncertainty = projection_uncertainty(whole.camera, whole.camera_covariance, 5)
    parts = (whole, whole.passport(), Passport.of_radius(255.0, 0.1), uncertainty)
    given = [
        (name, array) for part in parts for name, arrays in vars(part).items() for array in np_arrays(arrays)
    ]
    assert {"covariance", "residuals_px", "weights", "values", "sigma_px"} < {name for name, _ in given}
    assert not [name for name, array in given if array.flags.writeable]


def test_each_expanded_uncertainty_has_its_own_k(result):
    assert result.U["k1"] == pytest.approx(2.6 * result.sigma["k1"])
    assert result.U["cy"] == pytest.approx(result.coverage_factor * result.sigma["cy"])
    assert result.values["fx"] == result.camera.fx
    assert list(result.values) == list(result.U) == list(result.k) == list(result.parameter_names)


def test_a_result_shows_itself_in_twenty_lines_and_escapes_html(result):
    assert len(repr(result).splitlines()) <= 20
    assert max(map(len, repr(result).splitlines())) < 130
    assert "fx" in repr(result)
    assert "6 more: result.notes" in repr(result)
    assert "a &lt; b" in methodcaller("_repr_html_")(result)  # as Jupyter calls it


def test_a_result_is_a_table_of_pandas(result):
    pytest.importorskip("pandas")
    table = result.frame()
    assert table.loc["k1", "U"] == pytest.approx(result.U["k1"])
    assert table.loc["fx", "unit"] == "px"


def test_without_pandas_the_error_says_what_to_do(result, monkeypatch):
    def missing(name, *rest):
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputMismatch, match="pandas is not installed"):
        result.frame()


def test_views_are_compared_by_identity_and_own_their_arrays():
    points = np.arange(2.0 * N).reshape(N, 2)
    own = view(points_px=points)
    points[0] = 99.0
    assert own.points_px[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        own.points_px[0, 0] = 1.0
    assert own == own
    assert own != replace(own)
    assert len(repr(own)) < 60


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"ids": np.arange(N) + 0.7}, "The id 0.7 is not a whole number"),
        ({"ids": np.full(N, np.nan)}, "The id nan is not a whole number"),
        ({"ids": np.full(N, 1e300)}, r"The id 1e\+300 is not a whole number of 64 bits"),
        ({"ids": np.full(N, 2**63, np.uint64)}, r"is not a whole number of 64 bits"),
        ({"ids": [str(i) for i in range(N)]}, "ids are not numbers"),
        ({"ids": np.arange(N).reshape(N, 1)}, r"ids have the shape \(6, 1\), and 6 ids need \(6,\)"),
        ({"points_px": np.zeros((N, 1, 2))}, r"points_px have the shape \(6, 1, 2\).*reshape\(-1, 2\)"),
        ({"points_px": np.zeros((2, N))}, r"points_px have the shape \(2, 6\).*column: give points_px\.T"),
        ({"points_px": np.zeros((N + 1, 2))}, r"points_px have the shape \(7, 2\), and 6 ids"),
        ({"target_mm": np.zeros((N, 3))}, r"target_mm have the shape \(6, 3\).*leave out Z"),
        ({"covariances_px2": 0.04 * np.eye(2)}, r"covariances_px2 .*\(2, 2\).*one number for all"),
        ({"image_size": (480, 640, 3)}, r"image_size is \(480, 640, 3\)\. Give width and height"),
        ({"image_size": (640.5, 480)}, "Give width and height"),
        ({"covariances_px2": np.zeros((N, 2, 2))}, "covariance of point 0 is not symmetric with positive"),
        ({"covariances_px2": np.tile([[1.0, 0.5], [0.0, 1.0]], (N, 1, 1))}, "not symmetric"),
        ({"covariances_px2": np.tile([[1.0, 2.0], [2.0, 1.0]], (N, 1, 1))}, "positive variances"),
        ({"points_px": np.full((N, 2), "a")}, "points_px are not numbers"),
    ],
)
def test_a_view_that_is_none_is_refused_when_it_is_made(changed, says):
    with pytest.raises(InputMismatch, match=says):
        view(**changed)


def test_an_image_size_of_any_kind_of_whole_numbers_is_two_integers():
    assert view(image_size=np.array([640.0, 480.0])).image_size == (640, 480)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: calibrate(view()), "Of 1 views, 0 can be used"),
        (lambda: calibrate([(np.zeros((N, 2)), np.zeros((N, 2)))] * 2), "A view is a tuple"),
        (lambda: calibrate([view()], {"distortion": "k1k2"}), "The options are a dict. Make them"),
        (lambda: CalibrationOptions(passport=255.0), "The passport is a float. Make it"),
        (lambda: CalibrationOptions(distortion=2), "The distortion is 2. Name the lens"),
        (lambda: Passport.of_radius("255", 0.05), "is a text. Give numbers"),
        (lambda: Passport.of_radius(0.05, 255.0), "larger than its radius, 0.05 mm. Give the radius first"),
        (lambda: calibration("k1k2").camera.project(np.zeros((N, 2))), r"the shape \(6, 2\), not \(N, 3\)"),
        (lambda: projection_uncertainty(calibration("k1k2").camera, np.eye(9)), r"\(9, 9\).*need \(6, 6\)"),
    ],
)
def test_what_is_of_another_kind_is_refused_in_words(call, says):
    with pytest.raises(CalibrationError, match=says):
        call()


def test_whole_numbers_of_any_type_name_stars():
    assert view(ids=np.arange(N).astype(float)).ids.tolist() == list(range(N))
