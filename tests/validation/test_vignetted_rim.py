"""A beam whose light falls off towards its rim: the covariances of stars there include the shift by uneven light."""

from dataclasses import replace

import numpy as np
import pytest

from calib import calibrate, detect_view
from calib.stars.rim import downweight_vignetted
from simulators.optics.picture import TARGET, pose_rotation, project, render
from simulators.world.truth_config import truth_from_config

POSES = ((0, 0, 7), (6, 3, 20), (-6, -3, 97), (5, -4, 50))


@pytest.fixture(scope="module")
def vignetted():
    """Return the truth and four views of noisy pictures; the light falls off over the outer 30 % of the beam."""
    truth = truth_from_config({"collimator": {"rim": 0.3}, "optics": {"mounting_deg": [0, 0, 5]}})
    rng, views, errors = np.random.default_rng(1), [], []
    for pan, tilt, roll in POSES:
        rotation = pose_rotation({"pan": pan, "tilt": tilt, "roll": roll}, truth.optics)
        picture = render(truth, rotation)
        noisy = picture + 0.02 * picture.max() * rng.standard_normal(picture.shape, np.float32)
        views.append(detect_view(noisy, TARGET, name=f"{pan} {tilt} {roll}"))
        errors.append(views[-1].points_px - project(views[-1].target_mm, rotation, truth))
    return truth.to_dict(), views, errors


def sigmas_px(view):
    return np.sqrt(np.trace(view.covariances_px2, axis1=1, axis2=2) / 2)


@pytest.mark.slow
def test_stars_in_uneven_light_have_larger_errors_and_larger_covariances(vignetted):
    _, views, errors = vignetted
    sigma = np.concatenate([sigmas_px(view) for view in views])
    error = np.concatenate(errors)
    dim = sigma > 4 * np.median(sigma)
    assert dim.sum() > 20
    assert np.sqrt((error[dim] ** 2).mean()) > 4 * np.sqrt((error[~dim] ** 2).mean())
    z = error / sigma[:, None]
    assert 0.6 < np.sqrt((z[dim] ** 2).mean()) < 1.2
    assert 0.8 < np.sqrt((z[~dim] ** 2).mean()) < 1.3


@pytest.mark.slow
def test_these_covariances_keep_the_focal_length_right(vignetted):
    truth, views, _ = vignetted
    fx = truth["camera"]["fx"]
    weighed = calibrate([downweight_vignetted(view, TARGET) for view in views])
    assert abs(weighed.camera.fx - fx) < 2 * weighed.sigma["fx"]
    assert abs(weighed.camera.fx - fx) < 1.2
    # Without them, the adjustment finds by itself that stars near the rim scatter more.
    dims = [sigmas_px(view) > 4 * np.median(sigmas_px(view)) for view in views]
    alike = calibrate([replace(view, covariances_px2=float(np.median(sigmas_px(view)))) for view in views])
    assert np.median(np.concatenate([w[dim] for w, dim in zip(alike.weights, dims, strict=True)])) < 0.3
    assert abs(alike.camera.fx - fx) < 2 * alike.sigma["fx"]
    assert abs(alike.camera.fx - fx) < 1.2
