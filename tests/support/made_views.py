"""Views of drawn numbers, for tests that store and read them."""

from dataclasses import replace

import numpy as np

from calib.view import RimPoints, View


def made_rim(points=7, lit=0, seed=2):
    rng = np.random.default_rng(seed)
    return RimPoints(rng.normal(size=(points, 2)), rng.random(points), rng.random((lit, 2)), 0.25)


def made_view(name="left", stars=50, *, size=(1280, 720), rim=None, seed=1):
    rng = np.random.default_rng(seed)
    points, target, roots = (rng.normal(size=shape) for shape in ((stars, 2), (stars, 2), (stars, 2, 2)))
    covariances = roots @ np.swapaxes(roots, 1, 2) + 0.01 * np.eye(2)
    return View(name, size, np.arange(100, 100 + stars), points, target, covariances, rim)


def shifted(view, which, by_px):
    """The view with some of its image points elsewhere; ``which`` is any index of NumPy."""
    points = view.points_px.copy()
    points[which] += by_px
    return replace(view, points_px=points)
