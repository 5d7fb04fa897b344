"""A recording without a tag and without stars: whether it shows light at all.

A dark lamp and a closed lens cap are no fault of the camera's direction. `bench.align.advice` tells the same cases
apart on the live picture.
"""

from __future__ import annotations

from bench.records.events import MeasuredFacts
from calib.errors import TargetNotFound

LEAST_LIT = 0.005
"""Share of the sensor's pixels that follow the flicker as soon as the camera sees the lit target. Without light, hot
pixels alone do."""


def without_light(error: TargetNotFound, facts: MeasuredFacts, pixels: int) -> TargetNotFound:
    """Return the error of a recording that shows no target; if it shows no light either, one that says so.

    pixels: Number of pixels of the sensor.
    """
    image = facts.get("image")
    if image is None or image["lit_pixels"] >= LEAST_LIT * pixels:
        return error
    source = "the sync signal comes" if facts.get("flicker_source") == "triggers" else "some events flicker"
    return TargetNotFound(
        f"The picture is dark: {source}, but only {100 * image['lit_pixels'] / pixels:.2g} % of the pixels follow the "
        "light.",
        where=error.where,
        remedy="Check first that the lamp is lit. Then remove the lens cap, open the aperture, raise the light's "
        "level, or turn the camera towards the collimator.",
    )
