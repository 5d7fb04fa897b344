"""Times in files of events: sorted, in us, and through the turn of a counter of 32 bits."""

import numpy as np
import pytest
from imported import import_events
from made_event_files import drawn_rows, write_hdf5, write_npz

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats import event_conversion
from drivers.errors import NotARecording

N = 2000
SIZED = ReadingChoices((640, 480))
ROWS = drawn_rows(3, N, (640, 480), from_us=5_000_000, span_us=1_000_000)


@pytest.mark.parametrize(
    ("make", "order"),
    [(write_npz, np.random.default_rng(1).permutation(N)), (write_hdf5, np.arange(N)[::-1])],
)
def test_events_that_are_not_sorted_are_refused(tmp_path, make, order):
    """Those in descending order step back by half a millisecond each."""
    path = make(tmp_path, {name: values[order] for name, values in ROWS.items()})
    with pytest.raises(NotARecording, match=r"from \d+ to \d+ us.*Sort"):
        import_events(path, SIZED)


def test_a_clock_that_begins_anew_is_told_with_its_place(tmp_path):
    t = np.concatenate([ROWS["t"][:1200], ROWS["t"][1200:] - ROWS["t"][1200]])
    with pytest.raises(NotARecording, match=f"from {t[1199]} to 0 us, .* 1200: .*anew"):
        import_events(write_npz(tmp_path, ROWS | {"t": t}), SIZED)


def test_packets_that_a_computer_has_mixed_up_are_read(tmp_path):
    """Five events last some 2 ms here."""
    t = ROWS["t"].copy()
    t[500:510] = np.roll(t[500:510], 5)
    assert np.array_equal(import_events(write_npz(tmp_path, ROWS | {"t": t}), SIZED).events.t, t)


def test_a_counter_of_32_bits_goes_on_where_it_turns_over(tmp_path):
    begun = 2**32 - 5_400_000
    imported = import_events(write_hdf5(tmp_path, ROWS | {"t": (ROWS["t"] + begun).astype("u4")}), SIZED)
    assert np.array_equal(imported.events.t, ROWS["t"] + begun)


def test_times_with_parts_of_a_us_that_would_last_for_days_are_refused(tmp_path):
    with pytest.raises(NotARecording, match=r"12 days.* in us"):
        import_events(write_hdf5(tmp_path, ROWS | {"t": ROWS["t"] + 0.5}), SIZED)


def test_a_conversion_tells_how_long_the_recording_is(tmp_path):
    """Times in ns look like a recording that is a thousand times as long."""
    written = event_conversion.convert(write_npz(tmp_path, ROWS), tmp_path / "b.h5", "hdf5", SIZED)
    assert written.span_us == ROWS["t"][-1] - ROWS["t"][0]
