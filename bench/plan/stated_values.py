"""What a calibration file states by names without case and punctuation: numbers, once or several times, and the size.

A thing that a file states twice must be the same twice.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from bench.plan.camera_text import OtherForm, numbers
from bench.plan.possible_camera import LARGEST

Values = Mapping[str, Any]

OF_OTHER_FORM = (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError)
"""What reading a file of another form raises."""
_SAME = 1e-6
"""Two statements of one number may differ by so much: digits that a program left out."""
_TIMES = re.compile("[xX*]")
"""Between width and height: 1280x720."""
_SIZES = (
    "imagesize", "imgsize", "resolution", "imagersize", "imageresolution", "cameraresolution", "imagedimension",
)  # fmt: skip
_SIZES_OF_ANYTHING = ("size", "dimensions")
_SIDES_OF_ANYTHING = ("cols", "rows")
_LAST_OF_SIZES = ("dim",)
"""Names that may be those of a board or a matrix too: asked in this order if there is no other."""
_SIDES = [
    (f"{of}{width}", f"{of}{height}")
    for of in ("image", "", "img", "imagesize", "resolution", "imgdist")
    for width, height in (("width", "height"), ("w", "h"))
] + [("resx", "resy"), ("resw", "resh")]


def listed(values: Values, names: Iterable[str]) -> dict[str, Any]:
    """Return the values of such names that are a list or a matrix, in the order of the names."""
    stated = {name: values[name] for name in names if name in values}
    return {
        name: value
        for name, value in stated.items()
        if isinstance(value, str | tuple)
        or (isinstance(value, list) and not any(isinstance(part, Mapping) for part in value))
        or (isinstance(value, Mapping) and "data" in value)
    }


def agreed(what: str, by_place: Mapping[str, Sequence[float]]) -> Sequence[float]:
    """Return the first of some statements of one thing. Raises OtherForm if another one has other numbers."""
    first, *others = by_place
    for other in others:
        same = len(by_place[first]) == len(by_place[other])
        if not same or not np.allclose(by_place[first], by_place[other], rtol=_SAME, atol=_SAME):
            raise OtherForm(
                f"it states {what} twice, and {first!r} and {other!r} have different numbers",
                "Keep the right one in a copy of the file.",
            )
    return by_place[first]


def size_of_values(values: Values) -> tuple[int, int]:
    """Return width and height of the image, px."""
    stated = _sizes(values, _SIZES) | {
        " and ".join(names): [values[name] for name in names] for names in _SIDES if set(names) <= set(values)
    }
    stated = stated or listed(values, _SIZES_OF_ANYTHING)
    if not stated and set(_SIDES_OF_ANYTHING) <= set(values):
        stated = {"cols and rows": [values[name] for name in _SIDES_OF_ANYTHING]}
    stated = stated or _sizes(values, _LAST_OF_SIZES)
    if not stated:
        raise OtherForm("it does not state the size of the image", "Add image_width and image_height, px.")
    words = {
        name: _TIMES.sub(" ", value) if isinstance(value, str) else value for name, value in stated.items()
    }
    sizes = {name: numbers_of("the size of the image", value) for name, value in words.items()}
    sides = agreed("the size of the image", sizes)
    if len(sides) != 2 or any(side != int(side) for side in sides):
        raise OtherForm(
            "the size of the image is not a width and a height", "Write image_width and image_height, px."
        )
    return int(sides[0]), int(sides[1])


def _sizes(values: Values, names: Iterable[str]) -> dict[str, Any]:
    """Return the sizes of such names: lists, and width and height one level below."""
    return listed(values, names) | {
        name: [named[width], named[height]]
        for name in names
        if isinstance(values.get(name), Mapping)
        and (named := {str(side).lower(): length for side, length in values[name].items()})
        for width, height in (("width", "height"), ("w", "h"))
        if {width, height} <= set(named)
    }


def numbers_of(what: str, value: Any) -> list[float]:
    """Return the numbers of ``what``, row after row. Raises OtherForm if there are others than finite numbers."""
    try:
        values = numbers(value)
    except OF_OTHER_FORM:
        raise OtherForm(
            f"{what} is no list of numbers", "Write plain numbers, neither text nor base64."
        ) from None
    if not (np.abs(values) < LARGEST).all():
        raise OtherForm(f"{what} has a value that is not finite")
    return values
