"""A recording without stars: a dark lamp is not told as a camera that looks elsewhere."""

import numpy as np
import pytest

from bench.views import measure as measuring
from bench.views.event_window import WholeImage
from bench.views.measure import measure
from calib.target import StarTarget

PIXELS = (720, 1280)


@pytest.mark.parametrize(
    ("lit", "source", "told"),
    [
        (12, "triggers", "The picture is dark: the sync signal comes, but only 0.0013 % of the pixels follow the light."),
        (12, "events", "The picture is dark: some events flicker, but only 0.0013 % of the pixels follow the light."),
        (400_000, "triggers", "Tag 3 of family 36h11 is not in the image, and no stars are either."),
    ],
)  # fmt: skip
def test_a_dark_picture_is_told_from_one_without_target(tmp_path, monkeypatch, lit, source, told):
    def picture(_data, _image, _periods, _hz, facts, **_):
        facts["flicker_source"], facts["image"] = source, {"lit_pixels": lit}
        return WholeImage(np.zeros(PIXELS, np.float32), lambda: iter(()))

    monkeypatch.setattr(measuring, "read_events", lambda _path: ())
    monkeypatch.setattr(measuring, "whole_image", picture)
    found = measure(
        tmp_path / "a.raw", name="left", target=StarTarget(), image="auto", periods=None, expected_hz=60.0
    )
    assert found.fault.startswith(f"view left: {told}")
    assert found.fault.index("lamp is lit" if lit < 100 else "Turn the camera") > 0
