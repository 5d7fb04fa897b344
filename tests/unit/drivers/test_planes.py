"""Planes of bytes become one stream of zlib that any reader decompresses, and that is not larger than it need be."""

import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drivers.camera.formats.planes import zlib_of_planes

RNG = np.random.default_rng(5)
KINDS = {
    "constant": np.full(65536, 200, np.uint8),
    "random": RNG.integers(0, 256, 65536).astype(np.uint8),
    "runs": np.repeat(RNG.integers(0, 256, 1024), 64).astype(np.uint8),
    "a few values": RNG.integers(0, 5, 65536).astype(np.uint8),
    "runs of random values": np.repeat(RNG.integers(0, 256, 32768), 2).astype(np.uint8),
}


def old(planes):
    deflate = zlib.compressobj(1, strategy=zlib.Z_RLE)
    return deflate.compress(planes.tobytes()) + deflate.flush()


@given(
    arrays.arrays(np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 300)), elements=st.integers(0, 255))
)
def test_what_was_compressed_is_what_comes_out(planes):
    assert zlib.decompress(zlib_of_planes(planes)) == planes.tobytes()


@pytest.mark.parametrize("value", [0, 1, 255])
@pytest.mark.parametrize("count", [1, 2, 5552, 65536, 100_001])
def test_constant_planes_of_any_length_have_the_check_sum_of_their_bytes(value, count):
    planes = np.array([[3] * count, [value] * count], np.uint8)
    assert zlib.decompress(zlib_of_planes(planes)) == planes.tobytes()


@pytest.mark.parametrize("first", KINDS)
@pytest.mark.parametrize("second", KINDS)
def test_no_kind_of_plane_takes_much_more_than_if_zlib_had_looked_at_it(first, second):
    planes = np.array([KINDS[first], KINDS[second]])
    packed = zlib_of_planes(planes.T.copy().T)  # also where a plane is not one piece of memory
    assert zlib.decompress(packed) == planes.tobytes()
    assert len(packed) < 1.02 * len(old(planes)) + 500
