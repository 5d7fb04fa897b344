"""Points without noise, as of another ray tracer: a collimator with errors, and a certificate of what the camera sees."""

from pathlib import Path

import numpy as np
import pytest
from slow_cases import slow

from calib import CalibrationOptions, Passport, View, calibrate

POINTS = Path(__file__).parents[3] / "data/exact_points.npz"


def views_with(noise_px: float) -> list[View]:
    rng = np.random.default_rng(0)
    with np.load(POINTS) as a:
        return [
            View(
                f"p{i}",
                (1280, 720),
                a[f"ids{i}"],
                a[f"points_px{i}"] + noise_px * rng.normal(size=a[f"points_px{i}"].shape),
                a[f"target_mm{i}"],
                a[f"covariances_px2{i}"],
            )
            for i in range(3)
        ]


@pytest.mark.slow
@pytest.mark.parametrize("noise_px", [0.0, *(slow(px) for px in (1e-5, 1e-3))])
def test_what_a_certificate_states_is_believed_however_exact_the_points_are(noise_px):
    certificate = Passport.of_radius(254.8747, 0.05, length="seen")
    result = calibrate(views_with(noise_px), CalibrationOptions(distortion="k1k2", passport=certificate))
    assert 1.0 < result.U["fx"] < 1.5  # 2 x .02 % of the certificate
    assert result.U["cx"] < 2.0
