"""A recording that shows no target says why: dark, out of focus, or as the detector said."""

import cv2
import numpy as np
import pytest

from bench.measure.measure import why_no_target
from calib.errors import TargetNotFound

SAID = TargetNotFound("Tag 3 is not in the image.", where="view left")


def beam(square_px: int, blur_px: float = 0.0) -> np.ndarray:
    """A lit disc with a checkerboard in it, as (H, W) events of an edge."""
    y, x = np.mgrid[:720, :1280]
    inside = np.hypot(x - 640, y - 360) < 330
    image = ((x // square_px + y // square_px) % 2 + 0.0) if square_px else np.ones(x.shape)
    image = cv2.GaussianBlur(image, (0, 0), blur_px) if blur_px else image
    return (image * inside).astype(np.float32)


@pytest.mark.parametrize(
    ("image", "source", "words"),
    [
        (beam(12), "triggers", "Tag 3 is not in the image."),
        (beam(12, 20.0), "triggers", "The image is out of focus"),
        (beam(0), "triggers", "The image is out of focus"),
        (np.ones((720, 1280), np.float32), "triggers", "flickering light, and no picture in it"),
        (beam(12) * (np.arange(1280) < 420), "triggers", "The picture is dark"),
        (np.zeros((720, 1280), np.float32), "triggers", "The picture is dark: the sync signal comes"),
        (np.zeros((720, 1280), np.float32), "events", "The picture is dark: some events flicker"),
    ],
)
def test_the_reason_is_told_and_where(image, source, words):
    facts = {"image": {"lit_pixels": int(np.count_nonzero(image))}, "flicker_source": source}
    reason = why_no_target(SAID, facts, image)
    assert words in reason.what
    assert reason.where == "view left"
