"""Events become planes of bytes, as HDF5's filter shuffle would make them of the columns."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drivers.camera.event_arrays import Events
from drivers.camera.formats.planes import planes_of

SIZE = 64


def shuffled(values):
    """The bytes of numbers, plane by plane; after the last number zeros."""
    whole = np.concatenate([values, np.zeros(SIZE - len(values), values.dtype)])
    return whole.view(np.uint8).reshape(SIZE, -1).T


@given(st.integers(0, SIZE), arrays.arrays(np.int64, SIZE, elements=st.integers(0, 2**40)), st.booleans())
def test_planes_hold_the_bytes_of_all_events_in_order(number, t, is_steady):
    t = np.full(SIZE, t[0]) if is_steady else t
    x, y = (t % 1280).astype(np.uint16), (t // 7 % 720).astype(np.uint16)
    events = Events(t, x, y, (t % 2).astype(np.uint8)).part(0, number)
    assert np.array_equal(planes_of(events, SIZE), np.concatenate([shuffled(column) for column in events]))
