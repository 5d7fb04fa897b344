"""ECF chunks written by Prophesee's own encoder (hdf5_ecf), one of each style: we read them as it does.

The events are given by formulas; the bytes are what that program made of them. Where ours takes the same style,
its bytes are the same.
"""

import numpy as np
import pytest

from drivers.camera.event_arrays import Events
from drivers.camera.formats.ecf import decode, encode

K = np.arange(40)
SECOND = 10**9


def chunk(t, x, y, p):
    return Events(t.astype(np.int64), x.astype(np.uint16), y.astype(np.uint16), p.astype(np.uint8))


GOLDEN = {
    "scattered": (
        chunk(SECOND + K**3, K * 397 % 1280, K * 211 % 720, K * 7 % 3 % 2),
        (
            "a200000000ca9a3b00000000011171f3f101f5f201fdf301fbf501fff701f9fa01f9fd01fff0f101fbf4f101fdf8f101"
            "f5fdf101f3f2f201f7f7f201f1fdf201f1f3f301f7f9f301f3f0f401f5f7f401fdfef401fbf6f501fffef501f9f7f601"
            "f9f0f701fff9f701fbf3f801fdfdf801f5f8f901f3f3fa01f7fefa01f1fafb01f1f6fc01f7f2fd01f3fffd01f5fcfe01"
            "fdf9ff01fbf7f0f101fff5f1f1011b0000003466330d4e99271a8269c2079c28f514b7510222ead0840f05e1b71c1e14"
            "0a29533847176ca3702486d61104baa1091fd465322cef98190c2208c2263d28f506565121148b708401a4e0b70ebe13"
            "291bf2d946090ca3791627d603235a4009117565321e8e980b2bc3a8c118dc27f425f6501306"
        ),
    ),
    "few rows": (
        chunk(SECOND + 5 * K, K * 397 % 1280, K // 20, K * 7 % 3 % 2),
        (
            "a100000000ca9a3b00000000015151515151515151515151515151515151515151515151515151515151515151515151"
            "51515151140034000b0034314e6992269c58b7810a4d057e1e1483736c0586361a9ad42bef5882203d5256810b47a478"
            "be03926d0c9f27360a9475258e58831adc4cf670"
        ),
    ),
    "neighbours": (
        chunk(
            SECOND + K // 20,
            np.concatenate([np.arange(100, 120), np.arange(900, 940, 2)]),
            K // 20 + 5,
            K // 20,
        ),
        ("a000000000ca9a3b000000000f14001f1400b400d4009f0c5f0d1f0ed00e8a704a710a72ca728a734a7408751494"),
    ),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_chunks_of_the_makers_encoder_are_read_right(name):
    events, data = GOLDEN[name]
    decoded = decode(bytes.fromhex(data))
    assert all(np.array_equal(ours, theirs) for ours, theirs in zip(decoded, events, strict=True))


@pytest.mark.parametrize("name", GOLDEN)
def test_our_chunks_are_the_makers_byte_for_byte_where_the_style_is(name):
    events, data = GOLDEN[name]
    assert encode(events).hex() == data
