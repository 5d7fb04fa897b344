"""Events become planes of bytes, as HDF5's filter shuffle would make them of the columns."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drivers.camera.event_arrays import Events
from drivers.camera.formats.planes import plane_chunks

SIZE = 64


def shuffled(values):
    """The bytes of numbers, plane by plane; after the last number zeros."""
    whole = np.concatenate([values, np.zeros(SIZE - len(values), values.dtype)])
    return whole.view(np.uint8).reshape(SIZE, -1).T


@given(
    st.lists(st.integers(0, 150), max_size=6),
    arrays.arrays(np.int64, 150, elements=st.integers(0, 2**40)),
    st.booleans(),
)
def test_chunks_hold_the_bytes_of_all_events_in_order_however_they_come(lengths, t, is_steady):
    t = np.full(150, t[0]) if is_steady else t
    x, y = (t % 1280).astype(np.uint16), (t // 7 % 720).astype(np.uint16)
    whole = Events(t, x, y, (t % 2).astype(np.uint8))
    pieces = [whole.part(0, n) for n in lengths]
    chunks = list(plane_chunks(iter(pieces), SIZE))
    columns = [np.concatenate([column[:0], *parts]) for column, *parts in zip(whole, *pieces, strict=True)]
    assert [n for n, _ in chunks] == [min(SIZE, len(columns[0]) - k) for k in range(0, len(columns[0]), SIZE)]
    for k, (n, planes) in enumerate(chunks):
        part = slice(k * SIZE, k * SIZE + n)
        assert np.array_equal(planes, np.concatenate([shuffled(column[part]) for column in columns]))
