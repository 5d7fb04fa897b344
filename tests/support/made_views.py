"""Views of drawn numbers, for tests that store and read them."""

import numpy as np

from calib.view import RimPoints, View


def made_rim(points=7, lit=0, seed=2):
    rng = np.random.default_rng(seed)
    return RimPoints(rng.normal(size=(points, 2)), rng.random(points), rng.random((lit, 2)), 0.25)


def made_view(name="left", stars=50, *, size=(1280, 720), rim=None, seed=1):
    rng = np.random.default_rng(seed)
    numbers = (rng.normal(size=shape) for shape in ((stars, 2), (stars, 2), (stars, 2, 2)))
    return View(name, size, np.arange(100, 100 + stars), *numbers, rim)
