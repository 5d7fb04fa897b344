"""Shapes of the errors of glass and print as coefficients of fields, and the names of what a result states of them."""

from __future__ import annotations

from functools import partial

import numpy as np

from calib.arrays import Array

from .fields import Fields, along, square

CENTRE, RADIAL, FIELD = ("x", "y", "r"), ("radial", "radial_4"), "common_"
#: radial_4 is typically so many times radial.
RADIAL_RATIO = 20.0
#: Odds beforehand that errors are 3.2 times larger than stated, or more: the tails of published measurements (Bailey,
#: 2017).
LARGER = 0.03 / 0.97
_X, _Y = np.eye(2)


def shift(fields: Fields) -> Array:
    """Return (2 K, 2) what a foot that moves along X or Y does to the field."""
    return -fields.shapes([lambda _: _X, lambda _: _Y])


def radial_shapes(fields: Fields) -> Array:
    """Return (2 K, 2) distortion of the collimator: |h|^2 h and |h|^4 h."""
    return fields.shapes([lambda h: square(h) * h, lambda h: square(h) ** 2 * h])


def about_shifted_axis(fields: Fields) -> Array:
    """Return (2 K, 8) what radial terms become about an axis shifted along X or Y, in their typical sizes."""
    shapes = []
    for e in (_X, _Y):
        shapes += [
            partial(lambda h, e: square(h) * e, e=e),
            partial(lambda h, e: along(h, e) * h, e=e),
            partial(lambda h, e: RADIAL_RATIO * square(h) ** 2 * e, e=e),
            partial(lambda h, e: RADIAL_RATIO * square(h) * along(h, e) * h, e=e),
        ]
    return fields.shapes(shapes)
