"""Times whose unit a file does not state: what no camera sends is refused, and the unit can be said."""

import numpy as np
import pytest
from imported import import_events
from made_event_files import drawn_rows, write_hdf5, write_npz

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats.event_conversion import convert
from drivers.camera.formats.event_files import open_events
from drivers.errors import NotARecording

N = 20_000
SIZE = (640, 480)
OTHERS = drawn_rows(4, N, SIZE, from_us=1000, span_us=200_000)
T_US = OTHERS.pop("t")
FRACTIONS = np.random.default_rng(5).integers(0, 1000, N)


@pytest.mark.parametrize("make", [write_npz, write_hdf5])
@pytest.mark.parametrize(
    ("unit", "t"),
    [
        ("ns", T_US * 1000),
        ("ns", T_US * 1000 + FRACTIONS),  # vid2e
        ("ms", T_US * 1e-3),
        ("ms", T_US * 1e-3 + 1e-7 * FRACTIONS),
        ("ms", T_US // 1000),  # EventNeRF
    ],
)
def test_times_in_another_unit_are_refused_and_read_once_it_is_said(tmp_path, make, unit, t):
    path = make(tmp_path, OTHERS | {"t": t})
    with pytest.raises(NotARecording, match=f"are probably in {unit}.*--time-unit {unit}"):
        import_events(path, ReadingChoices(SIZE))
    t_us = import_events(path, ReadingChoices(SIZE, time_unit=unit)).events.t
    assert np.abs(t_us - T_US).max() <= (999 if t.max() == 200 else 1)


@pytest.mark.parametrize("t", [T_US, T_US * 1e-6, T_US.astype("f8")])
def test_us_and_s_are_read_and_told_as_assumed(tmp_path, t):
    with open_events(write_npz(tmp_path, OTHERS | {"t": t}), ReadingChoices(SIZE)) as source:
        t_us = np.concatenate([events.t for events, _ in source.pieces()])
        assert source.assumed == {"time_unit": "s" if t.max() < 1000 else "us"}
    assert np.array_equal(t_us, T_US)


@pytest.mark.parametrize("rate", [0.006, 150.0])
def test_rates_between_rest_and_flicker_are_read(tmp_path, rate):
    span_us = 1e6 * N / (SIZE[0] * SIZE[1] * rate)
    t = np.linspace(0, span_us, N).astype(int)
    assert np.array_equal(
        import_events(write_npz(tmp_path, OTHERS | {"t": t}), ReadingChoices(SIZE)).events.t, t
    )


@pytest.mark.parametrize("given", ["us", "ms", "s"])
def test_a_given_unit_is_compared_with_the_rate_of_events(tmp_path, given):
    """A still camera is read once the name of its column states the unit."""
    t = np.sort(T_US * 1000 + FRACTIONS)
    with pytest.raises(NotARecording, match=f"in ns.* says {given}.*--time-unit ns"):
        import_events(write_npz(tmp_path, OTHERS | {"t": t}), ReadingChoices(SIZE, time_unit=given))
    np.savez(tmp_path / "a.npz", t_us=t, **OTHERS)
    assert np.array_equal(import_events(tmp_path / "a.npz", ReadingChoices(SIZE)).events.t, t)


def test_times_in_us_with_parts_of_a_us_are_told_by_every_unit_that_fits(tmp_path):
    """As of seconds times 1e6: 0.2 s; the 0.0002 s of ns would fit the rate too, but not parts of a ns."""
    few = {name: values[::3] for name, values in OTHERS.items()}
    np.savez(tmp_path / "a.npz", t=(T_US + FRACTIONS / 1000)[::3], **few)
    with pytest.raises(NotARecording, match=r"--time-unit us\.$"):
        import_events(tmp_path / "a.npz", ReadingChoices(SIZE))
    with pytest.raises(NotARecording, match=r"parts of a ns.*in us"):
        import_events(tmp_path / "a.npz", ReadingChoices(SIZE, time_unit="ns"))
    t_us = import_events(tmp_path / "a.npz", ReadingChoices(SIZE, time_unit="us")).events.t
    assert np.abs(t_us - T_US[::3]).max() <= 1


def test_a_layout_whose_times_are_in_us_needs_no_guess(tmp_path):
    """Those that add an offset, and Starbench's own, at any rate."""
    t = T_US * 1000
    path = write_hdf5(tmp_path, OTHERS | {"t": t}, t_offset=0)
    assert np.array_equal(import_events(path, ReadingChoices(SIZE)).events.t, t)
    convert(path, tmp_path / "b.npz", "numpy", ReadingChoices(SIZE, time_unit="us"))
    convert(tmp_path / "b.npz", tmp_path / "c.h5", "hdf5", ReadingChoices())
    assert np.array_equal(import_events(tmp_path / "c.h5").events.t, t)


@pytest.mark.parametrize("name", ["timestamp_ns", "t_nsec", "Time (nanoseconds)"])
def test_the_name_of_a_column_states_the_unit(tmp_path, name):
    np.savez(tmp_path / "a.npz", **{name: T_US * 1000, **OTHERS})
    assert np.array_equal(import_events(tmp_path / "a.npz", ReadingChoices(SIZE)).events.t, T_US)


def test_a_unit_that_contradicts_the_file_is_refused(tmp_path):
    with pytest.raises(NotARecording, match=r"in us\. .*--time-unit"):
        import_events(
            write_hdf5(tmp_path, OTHERS | {"t": T_US}, t_offset=0), ReadingChoices(SIZE, time_unit="ns")
        )
    (tmp_path / "a.raw").write_bytes(b"% evt 3.0\n% geometry 640x480\n% end\n")
    with pytest.raises(NotARecording, match="Leave out --time-unit"):
        import_events(tmp_path / "a.raw", ReadingChoices(time_unit="ns"))


@pytest.mark.parametrize("unit", ["ns", "ms"])
def test_times_since_1970_in_another_unit_are_read_once_it_is_said(tmp_path, unit):
    since = 1_600_000_000_000_000 + T_US
    path = write_npz(tmp_path, OTHERS | {"t": since * 1000 if unit == "ns" else since * 1e-3})
    with pytest.raises(NotARecording, match=f"2100: .* in {unit}"):
        import_events(path, ReadingChoices(SIZE))
    imported = import_events(path, ReadingChoices(SIZE, time_unit=unit))
    assert np.abs(imported.events.t - imported.events.t[0] - (T_US - T_US[0])).max() <= 1
    assert imported.header["date"] == "2020-09-13 12:26:40"


@pytest.mark.parametrize(
    ("t", "why"),
    [
        (np.where(np.arange(N) == 7, np.nan, T_US * 1e-6), "times are no numbers"),
        (np.float32(1.7e9 + T_US * 1e-6), "one time: .* float64"),  # since 1970: multiples of 128 s
    ],
)
def test_times_that_are_lost_are_told(tmp_path, t, why):
    with pytest.raises(NotARecording, match=why):
        import_events(write_npz(tmp_path, OTHERS | {"t": t}), ReadingChoices(SIZE))


@pytest.mark.parametrize(("size", "is_told"), [((1280, 720), True), ((640, 480), False), ((640, 720), False)])
def test_a_given_size_that_the_events_do_not_fill_is_told(tmp_path, size, is_told):
    written = convert(
        write_npz(tmp_path, OTHERS | {"t": T_US}), tmp_path / "b.npz", "numpy", ReadingChoices(size)
    )
    assert written.assumed.get("sensor_size") == ("640 x 480" if is_told else None)
