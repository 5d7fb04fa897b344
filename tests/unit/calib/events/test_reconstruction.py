"""Reconstruction of pictures from a moving camera's events: against the published equation in closed form."""

import math

import numpy as np
import pytest

from calib.errors import InputMismatch, TooFewEvents
from calib.events.reconstruction import FORGOTTEN, HighPassFilter, reconstruct

SIZE = (24, 16)
RNG = np.random.default_rng(3)


def random_events(count=4000, length_us=200_000):
    t = np.sort(RNG.integers(0, length_us, count)).astype(np.int64)
    x, y = (RNG.integers(0, side, count).astype(np.uint16) for side in SIZE)
    return t, x, y, RNG.integers(0, 2, count).astype(np.uint8)


def closed_form(events, at_us, alpha_us, polarity, *, later=False):
    """Sum of exp(-alpha |t - t_i|) over the events of each pixel, from the equation alone."""
    t, x, y, p = events
    chosen = (p == polarity) & ((t > at_us) if later else (t <= at_us))
    weights = np.exp(-alpha_us * np.abs(at_us - t[chosen]))
    return np.histogram2d(
        y[chosen],
        x[chosen],
        bins=[SIZE[1], SIZE[0]],
        range=[[-0.5, SIZE[1] - 0.5], [-0.5, SIZE[0] - 0.5]],
        weights=weights,
    )[0]


def test_the_filter_is_the_published_equation_exact_for_every_event():
    events, at_us = random_events(), 200_500.0
    filtered = HighPassFilter(SIZE, 7.0)
    filtered.add(events)
    for polarity in (0, 1):
        expected = closed_form(events, at_us, 2e-6 * math.pi * 7.0, polarity)
        np.testing.assert_allclose(filtered.sums_at(at_us)[polarity], expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("pieces", [1, 7, 4000])
def test_pictures_of_a_stream_do_not_depend_on_its_pieces(pieces):
    events, alpha_us = random_events(), 2e-6 * math.pi * 20.0
    parts = [tuple(part) for part in zip(*(np.array_split(each, pieces) for each in events), strict=True)]
    at_us = [50_000.0, 50_001.0, 120_000.0, 199_000.0]
    pictures = list(reconstruct(parts, SIZE, at_us, cutoff_hz=20.0))
    assert [picture.at_us for picture in pictures] == at_us
    reach_us = -math.log(FORGOTTEN) / alpha_us
    near = tuple(each[events[0] <= 50_000.0 + reach_us] for each in events)
    off, on = (closed_form(near, at_us[0], alpha_us, polarity) for polarity in (0, 1))
    later_off, later_on = (closed_form(near, at_us[0], alpha_us, p, later=True) for p in (0, 1))
    weight = (on + later_on).sum() / (off + later_off).sum()
    expected = 0.5 * ((on - later_on) - weight * (off - later_off))
    np.testing.assert_allclose(pictures[0].image, expected, atol=1e-5)


def moving_edge(speed_px_s=400.0):
    """A bright half plane that enters from the left: three ON events where its edge passes, in each row."""
    columns = np.arange(SIZE[0])
    t = np.repeat(1e6 * columns / speed_px_s, 3 * SIZE[1]).astype(np.int64)
    x = np.repeat(columns, 3 * SIZE[1]).astype(np.uint16)
    y = np.tile(np.repeat(np.arange(SIZE[1]), 3), SIZE[0]).astype(np.uint16)
    return t, x, y, np.ones(len(t), np.uint8)


def test_both_sides_of_an_edge_are_alike():
    (picture,) = reconstruct([moving_edge()], SIZE, [1e6 * 11.5 / 400.0], cutoff_hz=10.0)
    row = picture.image[8]
    np.testing.assert_allclose(row, -row[::-1], atol=1e-5)
    assert row[11] > 1.0 > -1.0 > row[12]


def test_a_hot_pixel_is_replaced():
    t, x, y, p = moving_edge()
    hot = np.sort(RNG.integers(0, 60_000, 500))
    order = np.argsort(np.concatenate([t, hot]), kind="stable")
    events = tuple(
        np.concatenate([own, np.full(500, value, own.dtype) if value is not None else hot])[order]
        for own, value in ((t, None), (x, 5), (y, 7), (p, 1))
    )
    (picture,) = reconstruct([events], SIZE, [1e6 * 11.5 / 400.0])
    (plain,) = reconstruct([moving_edge()], SIZE, [1e6 * 11.5 / 400.0])
    assert picture.image[7, 5] == pytest.approx(plain.image[7, 5], abs=0.5)


def test_a_camera_at_rest_is_said_to_be_at_rest():
    events = tuple(each[:0] for each in random_events())
    (picture,) = reconstruct([events], SIZE, [1000.0])
    with pytest.raises(TooFewEvents, match=r"Only 0\.00 % .* Move the camera"):
        picture.require_motion()


def test_a_time_that_steps_back_counts_at_the_latest_time_before():
    t, x, y, p = random_events()
    back = t.copy()
    back[2000] -= 40_000
    (picture,) = reconstruct([(back, x, y, p)], SIZE, [100_000.0])
    (plain,) = reconstruct([(t, x, y, p)], SIZE, [100_000.0])
    np.testing.assert_allclose(picture.image, plain.image, atol=0.01)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"at_us": [2.0, 1.0]}, "do not ascend"),
        ({"cutoff_hz": 0.0}, "0 Hz"),
        ({"cutoff_hz": math.nan}, "nan Hz"),
        ({"size": (8, 8)}, r"of a 8 x 8 sensor"),
        ({"size": (0, 8)}, "size of the sensor"),
    ],
)
def test_bad_input_is_named(change, message):
    given = {"size": SIZE, "at_us": [1.0], "cutoff_hz": 5.0} | change
    with pytest.raises(InputMismatch, match=message):
        list(reconstruct([random_events()], given.pop("size"), given.pop("at_us"), **given))
