"""Events, and the bytes of older files of them, that a test makes itself."""

import numpy as np

EVT2_HEAD = b"% evt 2.0\n% format EVT2;height=720;width=1280\n% end\n"
DAT_HEAD = b"% Data file containing CD events.\n% Version 2\n% Height 720\n% Width 1280\n"


def some_events(n=5000, *, step_us=7):
    chance = np.random.default_rng(3)
    rows = np.zeros(n, [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), (("p", "on"), "?")])
    rows["t"] = 64 + np.arange(n) * step_us
    rows["x"], rows["y"] = chance.integers(0, 640, n), chance.integers(0, 480, n)
    rows["on"] = chance.integers(0, 2, n)
    return rows


def same(ours, theirs):
    return all(np.array_equal(a, b) for a, b in zip(ours, theirs, strict=True))


def assert_same(found, rows, origin_us=0):
    assert np.array_equal(found.events.t + origin_us, rows["t"].astype(np.int64))
    assert np.array_equal(found.events.x, rows["x"])
    assert np.array_equal(found.events.y, rows["y"])
    assert np.array_equal(found.events.p, rows["on"])


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
