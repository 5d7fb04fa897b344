"""Laws of the simulated sensor under any light, with any settings and any noise: few examples, and many (slow)."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from still_picture import simulate

from simulators.pixels.biases import ALLOWED, PixelSettings
from simulators.pixels.evt3_writer import COUNTER_US, ERC_QUOTA, Evt3Writer, RateController
from simulators.pixels.sensor import Events, Link, Sensor, draw_noise_rates
from simulators.pixels.sensor_stream import sync_edges
from simulators.world.truth import NoiseTruth
from simulators.world.world import LightState
from tests.unit.simulators.pixels.ode_pixel import solve
from tests.unit.simulators.pixels.test_evt3_writer import read

WIDTH, HEIGHT = 64, 32
SEEDS = st.integers(0, 2**32 - 1)


def examples(few, many):
    """The same test with few examples, always the same, and with many."""
    marks = [pytest.mark.slow, pytest.mark.timeout(3600)]
    return pytest.mark.parametrize("examples", [few, pytest.param(many, marks=marks)])


def check(examples, **strategies):
    """Check a property at once, with the given number of examples."""
    return lambda holds: settings(max_examples=examples, derandomize=True, database=None)(
        given(**strategies)(holds)
    )()


@st.composite
def lights(draw):
    return LightState(
        waveform=draw(st.sampled_from(["square", "sine"])),
        frequency_hz=draw(st.floats(20.0, 500.0)),
        duty_percent=draw(st.floats(10.0, 90.0)),
        low_v=draw(st.sampled_from([0.0, 0.5, 3.0])),
        high_v=draw(st.floats(3.5, 5.0)),
        output=True,
        sync=True,
    )


@st.composite
def pixel_settings(draw, bandwidth=True):
    """Draw settings from biases, with any speed and ambient light; ``bandwidth``: the biases of the filters are drawn too."""
    names = [name for name in ALLOWED if bandwidth or name not in ("bias_fo", "bias_hpf")]
    biases = {name: draw(st.integers(*ALLOWED[name])) for name in names}
    from_biases = vars(PixelSettings.from_biases(biases))
    return PixelSettings(
        **from_biases | {"q_us": draw(st.floats(5, 300)), "ambient": draw(st.floats(0.05, 0.5))}
    )


def noises(hot=(0.0, 5e-3), hot_hz=(100.0, 5000.0)):
    return st.builds(
        NoiseTruth,
        mismatch=st.floats(0.0, 0.25),
        background_hz=st.floats(0.0, 50.0),
        hot_share=st.floats(*hot),
        hot_hz=st.floats(*hot_hz),
        reset_noise=st.floats(0.0, 0.03),
        dead_share=st.floats(0.0, 0.05),
    )


CUTS = st.lists(st.integers(1, 24_999), max_size=5, unique=True).map(sorted)
LINKS = st.builds(
    Link, row_us=st.floats(0.0, 3.0), event_us=st.floats(0.0, 0.05), words_us=st.floats(3.0, 100.0)
)


def picture(seed, width=WIDTH, height=HEIGHT):
    return np.random.default_rng(seed).random((height, width)).astype(np.float32)


def begun(light, setting, noise, seed, link=None):
    sensor = Sensor(WIDTH, HEIGHT, noise=noise, settings=setting, seed=seed, camera_seed=seed, link=link)
    sensor.begin(picture(seed), light, seed % 100 / 100)
    return sensor


# How the start of a pixel, which is computed in float32, moves its later events. ln u of the first reference has some
# roundings of 2^-24 (6e-8) and the error of ``exp32`` (3e-7): below 1e-6 together. The time of the first read is rounded
# twice to 2^-8 us (2 ns each), and ``log32`` adds 3e-7 of a time constant of at most 300 us / 0.05 (2 ns). Later events
# are exact, but each takes its reference where the last one left it: the first error stays. It moves an event by
# (error of ln u) / (slope of ln u), which is more than 0.1 us in a flat tail only.
START_ERRORS = ((1e-6, 6e-3), (1e-6, -6e-3))


@examples(12, 500)
def test_events_are_those_of_the_differential_equation(examples):
    seen = {"square": [], "sine": []}

    @check(examples, light=lights(), setting=pixel_settings(bandwidth=False), seed=SEEDS)
    def holds(light, setting, seed):
        noise = NoiseTruth(mismatch=0.12, background_hz=0.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.0)
        scene, phase, end = picture(seed, 1, 4), seed % 100 / 100, 1.5 * light.period_us
        sensor = Sensor(1, 4, noise=noise, settings=setting, camera_seed=seed, link=Link.ideal())
        sensor.begin(scene, light, phase)
        events, (on, off) = sensor.run(end), sensor.thresholds
        for y in range(4):
            pixel = light, scene[y, 0], phase, setting, (on[y, 0], off[y, 0]), end
            times, polarities = solve(*pixel)
            here = events.y == y
            sine = light.waveform == "sine"  # its table is good to 5e-5 of the light
            others = (
                [solve(*pixel, more) for more in (-5e-5, 5e-5)]
                if sine
                else [solve(*pixel, start_error=error) for error in START_ERRORS]
            )
            if not all(list(theirs) == list(polarities) for _, theirs in others):
                continue
            slack = np.max([abs(other - times) for other, _ in others], axis=0, initial=0.5 if sine else 0.0)
            slack += 0.0 if sine else 0.1
            assert list(events.p[here]) == list(polarities)
            errors = abs(events.t[here] + 0.5 - times)
            assert (errors <= 0.5 + slack).all()
            seen[light.waveform] += errors.tolist()

    square, sine = (np.array(seen[waveform]) for waveform in ("square", "sine"))
    assert min(len(square), len(sine)) > 3 * examples
    assert np.quantile(sine, 0.99) <= 0.5 + 1.0
    assert np.mean(square > 0.5 + 0.1) <= 1e-3


@examples(15, 500)
def test_time_and_place_are_in_order_and_a_pixel_is_dead_after_a_read(examples):
    shortest = []

    @check(
        examples,
        light=lights(),
        setting=pixel_settings(),
        noise=noises((0.01, 0.02), (1e5, 2e5)),
        seed=SEEDS,
        cuts=CUTS,
        link=LINKS | st.just(Link()),
    )
    def holds(light, setting, noise, seed, cuts, link):
        sensor = begun(light, setting, noise, seed, link)
        parts, begin = [], 0
        for end in [*cuts, 25_000]:
            parts.append(part := sensor.run(end))
            assert part.t.min(initial=begin) >= begin
            assert part.t.max(initial=begin) < end
            begin = end
        events = Events(*(np.concatenate(field) for field in zip(*parts, strict=True)))
        assert (np.diff(events.t) >= 0).all()
        assert events.x.max(initial=0) < WIDTH
        assert events.y.max(initial=0) < HEIGHT
        order = np.lexsort((events.t, events.x, events.y))
        same = np.diff(events.y[order].astype(int) * WIDTH + events.x[order]) == 0
        waits = np.diff(events.t[order])[same]
        assert waits.min(initial=10**6) > setting.dead_us - 1.0
        shortest.append(waits.min(initial=10**6) - setting.dead_us)

    assert np.mean(np.array(shortest) < 2.0) > 0.3  # hot pixels fire again as soon as they can


@examples(12, 300)
def test_what_is_read_at_one_time_is_one_row_from_left_to_right_and_the_next_read_waits(examples):
    @check(
        examples, light=lights(), setting=pixel_settings(), noise=noises(), seed=SEEDS,
        row_us=st.floats(1.0, 5.0), event_us=st.floats(0.0, 0.1),
    )  # fmt: skip
    def holds(light, setting, noise, seed, row_us, event_us):
        link = Link(row_us=row_us, event_us=event_us)  # so slow that no two reads share a microsecond
        events = begun(light, setting, noise, seed, link).run(25_000)
        times, first, count = np.unique(events.t, return_index=True, return_counts=True)
        for begin, n in zip(first, count, strict=True):
            read_out = slice(begin, begin + n)
            assert len(set(events.y[read_out].tolist())) == 1
            on_first = list(zip(1 - events.p[read_out].astype(int), events.x[read_out].tolist(), strict=True))
            assert on_first == sorted(on_first)
            assert len(set(events.x[read_out].tolist())) == n
        assert (np.diff(times) > row_us + count[:-1] * event_us - 1.0).all()


@examples(8, 200)
def test_the_readout_never_beats_its_peak_rate(examples):
    @check(examples, light=lights(), noise=noises(), seed=SEEDS, peak=st.floats(2.0, 100.0))
    def holds(light, noise, seed, peak):
        events = begun(light, None, noise, seed, Link(event_us=1.0 / peak)).run(25_000)
        # one row may straddle the begin of any 100 us, and a read lies anywhere in its microsecond
        ends = np.searchsorted(events.t, events.t + 100)
        assert (ends - np.arange(len(events.t))).max(initial=0) <= 101 * peak + WIDTH


@examples(12, 300)
def test_the_background_is_a_poisson_process_without_bias(examples):
    deviations = []

    @check(
        examples, noise=noises(), setting=pixel_settings(), seed=SEEDS,
        level=st.floats(0.0, 5.0), share=st.floats(0.1, 0.9),
    )  # fmt: skip
    def holds(noise, setting, seed, level, share):
        light = LightState(low_v=level, high_v=level, output=True)
        sensor = begun(light, setting, noise, seed)
        events = sensor.run(400_000)
        rates = draw_noise_rates(WIDTH, HEIGHT, noise, setting or PixelSettings(), seed).astype(float)
        expected = 0.4 * (rates / (1.0 + rates * setting.dead_us * 1e-6)).sum()  # a pixel is dead after each
        n, on = len(events.t), np.count_nonzero(events.p)
        early = np.count_nonzero(events.t < 400_000 * share)
        assert abs(n - expected) <= 5.0 * np.sqrt(expected) + 1
        if n > 100:
            deviations.append((n - expected) / np.sqrt(expected))
            deviations.append((2 * on - n) / np.sqrt(n))
            deviations.append((early - share * n) / np.sqrt(share * (1 - share) * n))

    far = np.abs(deviations) > 3.0
    assert len(far) > examples
    assert far.sum() <= max(2, 0.02 * len(far))  # 0.003 are to be expected
    assert abs(np.std(deviations) - 1.0) < max(0.3, 4.0 / np.sqrt(2 * len(deviations)))


@examples(20, 500)
def test_triggers_are_the_edges_of_the_light_however_time_is_sliced(examples):
    @check(examples, light=lights(), starts_us=st.floats(-60_000.0, 0.0), cuts=CUTS)
    def holds(light, starts_us, cuts):
        bounds = [0, *cuts, 25_000]
        pieces = [sync_edges(light, starts_us, a, b) for a, b in itertools.pairwise(bounds)]
        t, value = (np.concatenate([piece[k] for piece in pieces]) for k in range(2))
        expected = []
        for k in range(100):
            for edge, share in ((1, 0.0), (0, light.high_share)):
                at = np.floor(starts_us + (k + share) * light.period_us)
                expected += [(at, edge)] if 0 <= at < 25_000 else []
        assert list(zip(t.tolist(), value.tolist(), strict=True)) == sorted(expected)


@examples(15, 300)
def test_the_counters_count_what_entered_and_what_the_rate_controller_passed(examples):
    @check(examples, seed=SEEDS, rate=st.floats(0.1, 60.0), cuts=CUTS, erc=st.booleans())
    def holds(seed, rate, cuts, erc):
        rng = np.random.default_rng(seed)
        n = int(rate * 2_000)
        t = np.sort(rng.integers(0, 25_000, n) // 7 * 7 if rate < 1 else rng.integers(0, 2_000, n))
        events = Events(
            t, *(rng.integers(0, 40, n).astype(kind) for kind in (np.uint16, np.uint16, np.uint8))
        )
        controller, writer, words, left = RateController(), Evt3Writer(), [], 0
        for begin, end in zip([0, *cuts], [*cuts, 25_000 + 2 * COUNTER_US], strict=True):
            inside = slice(*np.searchsorted(t, [begin, end]))
            passed = controller.passed(t[inside]) if erc else slice(None)
            kept = Events(*(field[inside][passed] for field in events))
            left += len(kept.t)
            words.append(writer.write(*kept, until_us=end, entered_t=t[inside]))
        events_out, _, counters, _ = read(np.concatenate(words))
        assert sum(counters[0x14]) == n
        assert sum(counters[0x16]) == left == len(events_out)
        most = np.minimum(np.bincount(t // COUNTER_US), ERC_QUOTA) if erc else np.bincount(t // COUNTER_US)
        assert left == most.sum()


@examples(10, 300)
def test_slicing_does_not_change_the_stream_and_the_same_seed_gives_the_same_bytes(examples):
    @check(
        examples, light=lights(), setting=pixel_settings(), noise=noises(), seed=SEEDS, cuts=CUTS, link=LINKS
    )
    def holds(light, setting, noise, seed, cuts, link):
        def words(ends):
            sensor, writer = begun(light, setting, noise, seed, link), Evt3Writer(width=WIDTH, height=HEIGHT)
            controller = RateController()
            sent, begin = [], 0
            for end in ends:
                events = sensor.run(end)
                passed = controller.passed(events.t)
                events, entered = Events(*(field[passed] for field in events)), events.t
                edges, values = sync_edges(light, -1000.0, begin, end)
                sent.append(
                    writer.write(
                        *events, until_us=end, trigger_t=edges, trigger_value=values, entered_t=entered
                    ).tobytes()
                )
                begin = end
            return b"".join(sent)

        whole = words([25_000])
        assert words([*cuts, 25_000]) == whole
        assert words([25_000]) == whole


@examples(8, 100)
def test_another_seed_gives_other_noise_over_the_same_light(examples):
    @check(examples, light=lights(), seed=st.integers(0, 2**31))
    def holds(light, seed):
        noise = NoiseTruth(mismatch=0.1, background_hz=50.0, hot_share=0.0, hot_hz=0.0, reset_noise=0.02)
        a, b, again = (
            simulate(picture(1), light, 20_000, noise=noise, seed=s) for s in (seed, seed + 1, seed)
        )
        assert not np.array_equal(a.t, b.t)
        assert all(np.array_equal(x, y) for x, y in zip(a, again, strict=True))
