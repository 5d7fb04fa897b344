"""Events, and the bytes of older files of them, that a test makes itself."""

import h5py
import numpy as np

from drivers.camera.event_arrays import Events, Triggers

EVT2_HEAD = b"% evt 2.0\n% format EVT2;height=720;width=1280\n% end\n"
DAT_HEAD = b"% Data file containing CD events.\n% Version 2\n% Height 720\n% Width 1280\n"


def drawn_stream():
    """Events over three turns of the 24-bit clock with a gap between, and edges among them."""
    rng = np.random.default_rng(3)
    t = np.sort(rng.integers(9_000_000, 9_100_000, 5000))
    t[2500:] += 45_000_000
    events = Events(
        t.astype(np.int64),
        rng.integers(0, 1280, 5000).astype(np.uint16),
        rng.integers(0, 720, 5000).astype(np.uint16),
        rng.integers(0, 2, 5000).astype(np.uint8),
    )
    edges = np.sort(rng.integers(8_990_000, 54_200_000, 40)).astype(np.int64)
    return events, Triggers(edges, (np.arange(40) % 2).astype(np.uint8), np.zeros(40, np.uint8))


def some_events(n=5000, *, step_us=7):
    chance = np.random.default_rng(3)
    rows = np.zeros(n, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), (("p", "on"), "?")])
    rows["t"] = 64 + np.arange(n) * step_us
    rows["x"], rows["y"] = chance.integers(0, 640, n), chance.integers(0, 480, n)
    rows["on"] = chance.integers(0, 2, n)
    return rows


def drawn_rows(seed, n, size, *, from_us, span_us):
    """Columns t, x, y and p of some events."""
    chance = np.random.default_rng(seed)
    t = from_us + np.sort(chance.integers(0, span_us, n))
    return {
        "t": t,
        **{name: chance.integers(0, most, n) for name, most in zip("xyp", (*size, 2), strict=True)},
    }


def write_npz(folder, columns):
    """Write columns of events as np.savez does; return the path."""
    np.savez(folder / "a.npz", **columns)
    return folder / "a.npz"


def write_hdf5(folder, columns, **other):
    """Write columns of events into a group of an HDF5 file, and other data beside it; return the path."""
    with h5py.File(folder / "a.h5", "w") as file:
        for name, values in columns.items():
            file[f"events/{name}"] = values
        file.update(other)
    return folder / "a.h5"


def same(ours, theirs):
    return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def assert_same(recording, rows, origin_us=0):
    assert np.array_equal(recording.events.t + origin_us, rows["t"].astype(np.int64))
    assert np.array_equal(recording.events.x, rows["x"])
    assert np.array_equal(recording.events.y, rows["y"])
    assert np.array_equal(recording.events.p, rows["on"])


def evt2_words(*words):
    return EVT2_HEAD + np.array(words, "<u4").tobytes()


def dat_rows(rows):
    table = np.zeros((len(rows), 2), "<u4")
    table[:, 0] = rows["t"].astype(np.uint64) & 0xFFFFFFFF
    table[:, 1] = rows["x"] | (rows["y"].astype(np.uint32) << 14) | (rows["on"].astype(np.uint32) << 28)
    return DAT_HEAD + bytes([0x0C, 8]) + table.tobytes()


def evt21_words(rows, *, legacy=False):
    """Encode events as EVT2.1: a word for the events of one row, time and polarity within 32 columns."""
    words, high = [], -1
    for row in rows:
        t, x, y, on = (int(row[name]) for name in ("t", "x", "y", "on"))
        if t >> 6 != high:
            high = t >> 6
            words.append([0, 0x8000_0000 | high & 0x0FFF_FFFF])
        head = on << 28 | (t & 63) << 22 | (x & ~31) << 11 | y
        same = len(words) and words[-1][1] == head and words[-1][0] >> (x & 31) == 0
        if same:
            words[-1][0] |= 1 << (x & 31)
        else:
            words.append([1 << (x & 31), head])
    halves = np.array(words, "<u4")
    return (halves[:, ::-1] if legacy else halves).astype("<u4").tobytes()
