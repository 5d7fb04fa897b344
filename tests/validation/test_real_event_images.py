"""A real IMX636 recording: no event is lost in its images, and no target is found that is not there."""

import numpy as np
import pytest

from bench.measure.measure import measure
from calib import StarTarget, detect_view, make_images
from calib.errors import TargetNotFound
from calib.events.flicker import Flicker
from drivers.camera.raw_file import RawFile


@pytest.fixture
def recording(evk4_recording):
    raw = RawFile.open(evk4_recording)
    events, triggers = raw.read()
    return raw, events, triggers


def test_every_event_is_counted_in_its_pixel(recording):
    raw, events, _ = recording
    start, end = float(events.t[0]), float(events.t[-1]) + 1.0
    whole = Flicker((end - start) / 50.0, start, 0.5, 0.0, 0, "events")
    size = raw.width, raw.height
    made = make_images(*events, size, whole, window_us=(start, end))
    on = np.zeros((raw.height, raw.width), int)
    np.add.at(on, (events.y[events.p == 1], events.x[events.p == 1]), 1)
    assert len(events.t) == 82_469
    assert (made.sums.on_count == on).all()
    assert (made.sums.on_count + made.sums.off_count).sum() == len(events.t)
    assert ((made.named("any") > 0) == (made.sums.on_count + made.sums.off_count > 0)).all()


def test_a_steady_scene_is_no_target(recording):
    raw, events, _ = recording
    light = Flicker(16_667.0, float(events.t[0]), 0.5, 0.0, 0, "events")
    made = make_images(events.t, events.x, events.y, events.p, (raw.width, raw.height), light)
    for name in ("last-polarity", "count", "fired-per-edge", "lock-in"):
        with pytest.raises(TargetNotFound):
            detect_view(made.named(name), StarTarget())


def test_a_recording_without_flicker_ends_in_a_message(recording):
    raw, _, _ = recording
    measurement = measure(
        raw.path, name="real", target=StarTarget(), image="auto", periods=None, expected_hz=None
    )
    assert measurement.view is None
    assert "No period stands out" in measurement.fault
