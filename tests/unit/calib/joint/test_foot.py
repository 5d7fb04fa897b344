"""Glass can imitate another foot of the perpendicular, and another radius with it, while the camera stays right."""

import numpy as np

from calib import CalibrationOptions, View, calibrate
from calib.model.rotation import exp_map

_F, _R_MM, _SIGMA_PX = 3289.0, 245.8, 0.06
_MIDDLE_PX, _SIZE = np.array([649.0, 349.0]), (1280, 720)


def _views(seed: int) -> list[View]:
    """Return the views of nine poses within 2 degrees. Lens and collimator distort; the foot is at (0, 0)."""
    rng = np.random.default_rng(seed)
    target_mm = np.stack(np.meshgrid(5.0 * np.arange(-14, 15), 5.0 * np.arange(-10, 11)), -1).reshape(-1, 2)
    h = target_mm / _R_MM
    square = (h * h).sum(axis=1, keepdims=True)
    seen_mm = target_mm + _R_MM * (0.53 * square + 0.45 * square**2) * h
    views = []
    for number, (tilt, pan) in enumerate((t, p) for t in (-1.1, 0.0, 1.1) for p in (-1.85, 0.0, 1.85)):
        turn = np.radians([tilt + 0.1 * rng.normal(), pan + 0.1 * rng.normal(), 0.45])
        rays = np.column_stack([seen_mm, np.full(len(h), _R_MM)]) @ exp_map(turn[None])[0].T
        plane = rays[:, :2] / rays[:, 2:]
        s = (plane * plane).sum(axis=1, keepdims=True)
        px = _F * plane * (1.0 - 0.4 * s + 3.6 * s**2 - 10.0 * s**3) + _MIDDLE_PX
        ids = np.flatnonzero(((px > 10.0) & (px < np.array(_SIZE) - 10.0)).all(axis=1))
        noise = _SIGMA_PX * rng.normal(size=(len(ids), 2))
        covariances = np.tile(_SIGMA_PX**2 * np.eye(2), (len(ids), 1, 1))
        views.append(View(f"pose {number}", _SIZE, ids, px[ids] + noise, target_mm[ids], covariances))
    return views


def test_a_foot_that_a_search_has_moved_aside_is_looked_for_in_the_middle_of_the_stars() -> None:
    result = calibrate(_views(seed=7), CalibrationOptions(distortion="k1k2"))
    # The search from the closed form ends 11 mm beside the foot, and is less probable by 2 log 32.
    assert np.hypot(result.values["x"], result.values["y"]) < 2.0
    assert abs(result.values["r"] - _R_MM) < result.U["r"]
    assert abs(result.values["fx"] - _F) < result.U["fx"]
