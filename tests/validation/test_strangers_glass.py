"""The collimators of the strangers' worlds are those that were published, and are traced rightly."""

import numpy as np
import pytest

from tests.benchmarks.worlds import stranger
from tests.benchmarks.worlds import stranger_glass as glass

pytest.importorskip("optiland", reason="a ray tracer for benchmarks: pip install optiland")

#: mm: the catalogue of Thorlabs for AC254-100-A; the others by their books and patents.
PUBLISHED = {"doublet": 100.1, "tessar": 4.0, "triplet": 50.0, "parabolic mirror": 100.0}
PERFECT = glass.Tolerances(0.0, 0.0, 0.0, 0.0, 0.0)


def made(name, out_of_focus=0.0, loose=PERFECT):
    return glass.collimator(name, 250.0, np.random.default_rng(1), loose, (out_of_focus, np.zeros(2)))


@pytest.mark.parametrize("name", PUBLISHED)
def test_the_focal_length_is_the_published_one(name):
    assert glass.focal_mm(glass.DESIGNS[name][0]())[0] == pytest.approx(PUBLISHED[name], rel=1e-3)


@pytest.mark.parametrize("name", glass.DESIGNS)
def test_traced_rays_agree_with_paraxial_sums_and_the_polynomials_with_rays(name):
    traced = made(name)
    assert traced.efl_mm == pytest.approx(250.0, rel=1e-5)
    assert traced.error_mm < 1e-4  # .0013 px behind a lens of 16 mm


@pytest.mark.parametrize("name", glass.DESIGNS)
def test_a_target_out_of_focus_changes_the_length_that_is_seen_as_optics_says(name):
    traced = made(name, out_of_focus=0.03)
    for pupil_z_mm in (0.0, 7.0):
        r, defocus = traced.radius_and_defocus(pupil_z_mm)
        assert abs(defocus) == pytest.approx(0.03, rel=0.02)
        assert r == pytest.approx(traced.efl_mm + defocus * (traced.pupil_to_focus_mm - pupil_z_mm), abs=0.01)


def test_a_star_is_seen_where_the_ray_goes():
    traced = made("ploessl", 0.02, glass.Tolerances())
    pupils, tangents = np.array([[2.0, -1.0, 4.0], [0.0, 3.0, -6.0]]), np.array([[0.1, -0.05], [-0.02, 0.12]])
    at = traced.print_mm(pupils[:, :2] - tangents * pupils[:, 2:], tangents)
    assert traced.tangents(pupils, at) == pytest.approx(tangents, abs=1e-9)


def test_a_long_lens_shows_no_star_from_far_outside_of_its_image():
    for view in stranger.draw(13).views:  # 85 mm before a mirror for 17 degrees
        x, y = (view.mm / np.abs(view.mm).max()).T
        terms = np.stack([x**i * y**j for i in range(4) for j in range(4 - i)], axis=1)
        assert np.abs(view.px - terms @ np.linalg.lstsq(terms, view.px, rcond=None)[0]).max() < 2.0
