"""Event images: their values, their window, the choice between them, and input that is refused."""

import cv2
import numpy as np
import pytest

from calib.errors import InputMismatch, TooFewEvents
from calib.events import accumulation
from calib.events.accumulation import whole_period_window
from calib.events.event_image import make_images, make_quick_image
from calib.events.flicker import Flicker
from calib.events.grey_image import CLIPPED_SHARE, to_uint8

SIZE = (16, 12)
PERIOD = 10_000.0
FLICKER = Flicker(PERIOD, 1000.0, 0.5, 0.0, 0, "triggers")


def sort_events(events):
    """Return arrays t, x, y, p of a list of (t, x, y, p)."""
    t, x, y, p = np.array(sorted(events), np.int64).reshape(-1, 4).T
    return t, x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8)


def lit_square(periods=2, *, burst=1, spread=400, seed=0):
    """Return the events of a lit square of pixels, columns 4..9 and rows 3..8: `burst` events a pixel at each edge of the light."""
    rng = np.random.default_rng(seed)
    events = []
    for k in range(periods):
        for edge, p in ((1000, 1), (6000, 0)):
            for y in range(3, 9):
                for x in range(4, 10):
                    start = int(edge + k * PERIOD + rng.uniform(0, spread))
                    events.extend((start + 700 * n, x, y, p) for n in range(burst))
    return events


def images(events, **options):
    options.setdefault("window_us", (0, 20_000))
    return make_images(*sort_events(events), SIZE, FLICKER, **options)


def test_each_image_holds_its_events():
    made = images(lit_square(burst=3))
    inside = np.zeros((12, 16), bool)
    inside[3:9, 4:10] = True
    assert (made.sums.on_count[inside] == 6).all()
    assert (made.sums.off_count[inside] == 6).all()
    assert (made.named("any")[~inside] == 0).all()
    assert (made.sums.on_fired[inside] == 2).all()
    assert (made.sums.off_fired[inside] == 2).all()
    assert (made.fired_per_edge == inside).all()
    assert (made.sums.last_polarity[inside] == -1).all()
    assert (made.sums.last_polarity[~inside] == 0).all()
    assert np.isnan(made.sums.mean_latency_us()[~inside]).all()
    assert 0 < made.sums.mean_latency_us()[inside].min() <= made.sums.mean_latency_us()[inside].max() < 450


def test_any_is_one_where_a_pixel_fired_at_all_and_latency_is_brightest_where_it_fired_first():
    late = [(int(1000 + 380 + k * PERIOD), 12, 5, 1) for k in range(2)]
    early = [(int(1001 + k * PERIOD), 13, 5, 1) for k in range(2)]
    made = images([*lit_square(spread=400), *late, *early, (4000, 0, 0, 1)])
    fired, quick = made.named("any"), made.named("on-latency")
    assert set(np.unique(fired)) == {0.0, 1.0}
    assert fired[0, 0] == fired[5, 12] == 1
    assert fired[11, 15] == 0
    assert quick[5, 13] > quick[5, 12] > 0 == quick[11, 15]


def test_lock_in_adds_on_and_off_events_in_phase():
    made = images(lit_square(burst=2, spread=1))
    # 4 ON and 4 OFF events, bursts half a period apart, two events 700 us apart each
    expected = 8 * np.cos(np.pi * 700 / PERIOD)
    assert made.sums.lock_in[5, 6] == pytest.approx(expected, rel=1e-3)


def test_an_event_between_the_bursts_counts_for_no_edge():
    made = images([*lit_square(), (4000, 0, 0, 1), (9000, 1, 0, 0)])
    assert made.sums.on_count[0, 0] + made.sums.off_count[0, 0] == 1
    assert made.fired_per_edge[0, :2].tolist() == [0, 0]


def test_facts_state_what_the_slice_was_like():
    facts = images(lit_square(burst=2)).facts
    assert (facts.periods, facts.lit_pixels) == (2, 36)
    assert facts.events_per_edge == pytest.approx(2.0)
    assert facts.on_share == pytest.approx(0.5)
    assert 50 < facts.first_on_spread_us < 150
    assert facts.silent_rows == 0
    assert abs(images(lit_square(burst=2)).on_window.start_us % PERIOD - 1000) < 60


@pytest.mark.parametrize(
    ("events", "silent"),
    [([e for e in lit_square() if e[2] != 5], 1), ([*lit_square(), (4000, 0, 11, 1)], 0)],
    ids=["between lit rows", "outside of the lit ones"],
)
def test_a_row_without_events_between_lit_ones_is_silent(events, silent):
    assert images(events).facts.silent_rows == silent


def test_a_silent_column_is_counted_and_interpolated_in_every_image():
    made = images([e for e in lit_square() if e[1] != 6])
    assert (made.facts.silent_rows, made.facts.silent_columns) == (0, 1)
    for kind in ("fired-per-edge", "count", "last-polarity"):
        image = made.named(kind)
        assert (image[3:9, 6] == image[3:9, 5]).all()
        assert image[5, 6] != 0
    assert (made.halves[0][3:9, 6] == 255).all()
    beside_the_light = images([*lit_square(), (4000, 15, 4, 1)])
    assert beside_the_light.facts.silent_columns == 0


def test_several_events_an_edge_choose_lock_in_and_few_choose_fired_per_edge():
    few, several = images(lit_square(burst=1)).best(), images(lit_square(burst=4)).best()
    assert few.name == "fired-per-edge"
    assert "1.00 events per edge" in few.reason
    assert several.name == "lock-in"
    assert "4.00 events per edge" in several.reason


def test_where_pixels_change_one_after_the_other_their_events_are_counted():
    several = images(lit_square(burst=4))
    chosen = several.best(one_phase=False)
    assert chosen.name == "count"
    assert np.array_equal(chosen.image, several.named("count"))
    assert images(lit_square(burst=1)).best(one_phase=False).name == "fired-per-edge"


def test_a_hot_pixel_is_masked_and_filled_from_its_surroundings():
    hot = [(int(t), 14, 10, int(t) % 2) for t in np.linspace(0, 19_999, 60)]
    made = images([*lit_square(), *hot])
    assert made.hot[10, 14]
    assert made.facts.hot_pixels == 1
    assert made.named("count")[10, 14] == 0
    assert not made.hot[3:9, 4:10].any()


def test_events_beyond_the_last_whole_period_are_left_out():
    made = images(lit_square(periods=3), window_us=(0, 26_000))
    assert made.facts.periods == 2
    assert (made.sums.on_count + made.sums.off_count).sum() == 144
    assert made.sums.on_count.max() == 2


def test_33_ms_at_60_hz_count_as_two_periods():
    light = Flicker(1e6 / 60, 100.0, 0.5, 0.0, 0, "triggers")
    start, end, n = whole_period_window(np.array([0, 32_000]), light, (0.0, 33_000.0), None)
    assert (start, n) == (0.0, 2)
    assert end == pytest.approx(33_333.3, abs=0.1)


def test_the_window_begins_just_before_an_edge_where_there_is_room():
    start, _, n = whole_period_window(np.array([0, 50_000]), FLICKER, (3000.0, 29_000.0), None)
    assert n == 2
    assert start == pytest.approx(6000 - 100)


@pytest.mark.parametrize(
    ("events", "options", "error", "fault"),
    [
        (lit_square(), {"window_us": (0, 9_000)}, TooFewEvents, "9.00 ms hold 0 whole periods of 10.00 ms"),
        (lit_square(), {"periods": 3}, TooFewEvents, "hold 2 whole periods"),
        (lit_square(), {"window_us": (50_000, 80_000)}, TooFewEvents, "No event lies between"),
        ([], {"window_us": None}, TooFewEvents, "holds no events"),
        ([(5, 16, 0, 1)], {}, InputMismatch, "column 16"),
    ],
)
def test_what_makes_no_image_is_refused(events, options, error, fault):
    with pytest.raises(error, match=fault):
        images(events, **options)


def test_arrays_of_different_lengths_are_refused():
    t, x, y, p = sort_events(lit_square())
    with pytest.raises(InputMismatch):
        make_images(t, x[:-1], y, p, SIZE, FLICKER)


def test_every_image_has_a_name_and_other_names_are_refused():
    made = images(lit_square())
    for name in ("last-polarity", "any", "count", "fired-per-edge", "lock-in", "on-latency"):
        image = made.named(name)
        assert image.dtype == np.float32
        assert image.shape == (12, 16)
    with pytest.raises(InputMismatch, match="lock-in"):
        made.named("sum")


# ---------------------------------------------------------------- quick images


def counts_of(on, off):
    return np.stack([np.asarray(off, np.uint16), np.asarray(on, np.uint16)])


def scene(seed=1, shape=(60, 80)):
    """Which pixels see white print."""
    return np.kron(
        np.random.default_rng(seed).random((shape[0] // 10, shape[1] // 10)) > 0.5, np.ones((10, 10))
    )


@pytest.mark.parametrize("periods", [1, 3])
def test_one_event_an_edge_is_the_share_of_edges(periods):
    lit = scene()
    picture = make_quick_image(counts_of(periods * lit, periods * lit), periods)
    assert (picture.name, picture.hot_pixels) == ("fired-per-edge", 0)
    np.testing.assert_array_equal(picture.image, lit.astype(np.float32))
    half = make_quick_image(counts_of(periods * lit, 0 * lit), periods)
    np.testing.assert_array_equal(half.image, 0.5 * lit.astype(np.float32))


def test_more_events_of_some_pixels_do_not_show_in_a_black_and_white_image():
    lit = scene()
    on = lit.copy()
    on[:30] *= 2
    picture = make_quick_image(counts_of(on, lit), 1)
    assert picture.name == "fired-per-edge"
    np.testing.assert_array_equal(picture.image, lit.astype(np.float32))


def test_several_events_an_edge_carry_grey_levels():
    lit = np.tile(np.repeat([1.0, 0.0], 10), (60, 4))  # stripes: a corner with many events looks hot
    grey = np.where(np.arange(80) < 40, 2.0, 4.0) * lit
    picture = make_quick_image(counts_of(2 * grey, 2 * grey), 2)
    assert picture.name == "events-per-edge"
    np.testing.assert_allclose(picture.image, grey)


def test_hot_pixels_are_counted_and_replaced():
    lit = scene()
    on = lit.copy()
    hot = [(5, 5), (33, 71), (58, 40)]
    for row, column in hot:
        on[row, column] = 60_000
    picture = make_quick_image(counts_of(on, lit), 1)
    assert picture.hot_pixels == len(hot)
    np.testing.assert_array_equal(picture.image, lit.astype(np.float32))


def test_nothing_is_dark():
    picture = make_quick_image(np.zeros((2, 6, 8), np.uint16), 1)
    assert picture.name == "fired-per-edge"
    assert not picture.image.any()


# ---------------------------------------------------------------- grey

random = np.random.default_rng(2)

NOISE = random.normal(size=(90, 110))

IMAGES = {
    "noise": NOISE,
    "three values": random.integers(-1, 2, (80, 70)).astype(np.float32),
    "below zero": -np.abs(NOISE),
    "with nan": np.where(NOISE > 1.0, np.nan, NOISE),
    "with infinite values": np.where(NOISE > 1.5, np.inf, NOISE),
    "few bright pixels": np.where(random.random((100, 100)) < 0.001, 7.0, 1.0),
    "whole numbers": random.integers(0, 900, (60, 50)),
}


@pytest.mark.parametrize("image", IMAGES.values(), ids=IMAGES.keys())
def test_the_scale_reaches_from_quantile_to_quantile(image):
    values = image.astype(np.float32)
    finite = values[np.isfinite(values)]
    low, high = np.quantile(finite, [CLIPPED_SHARE, 1.0 - CLIPPED_SHARE])
    if high <= low:
        low, high = finite.min(), finite.max()
    scaled = (np.nan_to_num(values, nan=low).astype(float) - low) * (255.0 / (float(high) - low))
    np.testing.assert_array_equal(to_uint8(image), np.clip(scaled, 0, 255).astype(np.uint8))


@pytest.mark.parametrize("image", [np.full((4, 5), np.nan), np.full((4, 5), 3.0)])
def test_an_image_without_contrast_is_black(image):
    assert not to_uint8(image).any()


# ---------------------------------------------------------------- hot pixels

rng = np.random.default_rng(3)

ON = rng.poisson(2.0, (40, 50)).astype(np.uint32)

OFF = rng.poisson(3.0, (40, 50)).astype(np.uint32)

for at in [(0, 0), (39, 49), (1, 20), (17, 0), (30, 30), (30, 31)]:
    ON[at] += 40

ON.ravel()[rng.choice(ON.size, 150, replace=False)] += np.arange(150, dtype=np.uint32) // 6  # near the limits


@pytest.mark.parametrize("allowed", [0, 3, 8, 30])
def test_hot_pixels_are_those_of_the_median_filter(allowed):
    count = (ON + OFF).astype(np.int64)
    around = cv2.medianBlur(count.astype(np.uint16), 5)
    hot = accumulation.hot_pixels(ON, OFF, allowed)
    assert hot.any()
    np.testing.assert_array_equal(hot, 2 * count > 5 * around.astype(np.int64) + 2 * allowed)


def test_hot_pixels_are_replaced_by_the_median_around_them():
    image = rng.normal(size=(40, 50)).astype(np.float32)
    hot = rng.random((40, 50)) < 0.2
    hot[[0, 0, -1, -1], [0, -1, 0, -1]] = True
    expected = np.where(hot, cv2.medianBlur(image, 3), image)
    np.testing.assert_array_equal(accumulation.without_hot_pixels(image, hot), expected)


@pytest.mark.parametrize("periods", [2, 3, 4, 5])
def test_each_half_holds_the_edges_of_its_whole_periods_and_a_middle_period_is_in_neither(periods):
    hot = [(int(t), 14, 10, int(t) % 2) for t in np.linspace(0, periods * PERIOD - 1, 40 * periods)]
    events = [*lit_square(periods), *hot]
    half = periods // 2
    # One pixel lit in each period alone; its rising and its falling edge.
    for k in range(periods):
        events += [(int(1050 + k * PERIOD), k, 0, 1), (int(6050 + k * PERIOD), k, 0, 0)]
    made = images(events, window_us=(0, periods * PERIOD))
    first, second = made.halves
    share = round(255 / half)
    assert first[0, :periods].tolist() == [share] * half + [0] * (periods - half)
    assert second[0, :periods].tolist() == [0] * (periods - half) + [share] * half
    for seen in (first, second):
        assert (seen[3:9, 4:10] == 255).all()
        assert seen[10, 14] == 0


def test_one_period_has_no_halves():
    assert images(lit_square(1), window_us=(0, 10_000)).halves is None
