"""AEDAT4 packets that state or unpack to absurd sizes; frames and blocks are written by LZ4 and Zstandard themselves."""

import struct
import tracemalloc

import numpy as np
import pytest
from imported import import_events

from drivers.camera.formats import aedat4_packets
from drivers.camera.formats.aedat4_packets import MOST_PACKET_BYTES, UnreadablePacket, checked_packets
from drivers.errors import RecordingFileError

NONE, LZ4, ZSTD = 0, 1, 3
XML = (
    '<dv version="2.0"><node name="outInfo"><node name="0"><attr key="typeIdentifier">EVTS</attr>'
    '<node name="info"><attr key="sizeX">640</attr><attr key="sizeY">480</attr></node></node></node></dv>'
)
MAGIC = b"#!AER-DAT4.0\r\n"


def header(compression, text=XML):
    """A flatbuffer: root, vtable of three fields, table, text."""
    vtable = struct.pack("<HHHHH", 10, 20, 4, 12, 8) + b"\0\0"
    table = struct.pack("<iiI", 12, compression, 12) + struct.pack("<q", -1)
    body = struct.pack("<I", 16) + vtable + table + struct.pack("<I", len(text)) + text.encode() + b"\0"
    return MAGIC + struct.pack("<I", len(body)) + body


def packet(payload, stream=0):
    return struct.pack("<II", stream, len(payload)) + payload


def events_packet(n):
    """A size prefixed flatbuffer of n events."""
    rows = np.zeros(n, [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("on", "?"), ("pad", "V3")])
    rows["t"], rows["x"], rows["on"] = 1_700_000_000_000_000 + np.arange(n), np.arange(n) % 640, True
    vtable = struct.pack("<HHH", 6, 8, 4) + b"\0\0"
    vector = struct.pack("<I", n) + rows.tobytes()
    # prefix, root, identifier, vtable, table, padding, vector: its elements lie at a multiple of 8
    body = struct.pack("<I", 16) + b"EVTS" + vtable + struct.pack("<iI", 8, 8) + b"\0" * 4 + vector
    return struct.pack("<I", len(body)) + body


@pytest.fixture
def written(tmp_path):
    def write(compression, *packets):
        path = tmp_path / "a.aedat4"
        path.write_bytes(header(compression) + b"".join(map(packet, packets)))
        return path

    return write


def lz4_frame(data, **how):
    return pytest.importorskip("lz4.frame").compress(data, **how)


def zstd_frame(data, *, size=True, checksum=True):
    zstd = pytest.importorskip("backports.zstd")
    of = zstd.CompressionParameter
    options = {of.content_size_flag: int(size), of.checksum_flag: int(checksum)}
    compressor = zstd.ZstdCompressor(options=options)
    if size:
        compressor.set_pledged_input_size(len(data))
    return compressor.compress(data) + compressor.flush()


FRAMES = {
    "lz4": (LZ4, lz4_frame),
    "lz4-everything": (
        LZ4,
        lambda data: lz4_frame(
            data, store_size=True, content_checksum=True, block_checksum=True, block_size=7
        ),
    ),
    "lz4-plain": (LZ4, lambda data: lz4_frame(data, store_size=False, block_linked=False)),
    "zstd": (ZSTD, zstd_frame),
    "zstd-plain": (ZSTD, lambda data: zstd_frame(data, size=False, checksum=False)),
    "zstd-two-frames": (ZSTD, lambda data: zstd_frame(data[:500]) + zstd_frame(data[500:])),
    "zstd-skippable": (ZSTD, lambda data: struct.pack("<II", 0x184D2A53, 5) + b"hello" + zstd_frame(data)),
    "none": (NONE, lambda data: data),
}


@pytest.mark.parametrize("kind", FRAMES)
@pytest.mark.parametrize("data", [b"", b"a" * 300_000, np.random.default_rng(1).bytes(300_000)])
def test_every_frame_is_bounded_by_what_it_unpacks_to(written, kind, data):
    compression, frame = FRAMES[kind]
    found = list(checked_packets(written(compression, frame(data), frame(b"x" * 100))))
    assert len(found) == 2
    assert len(data) <= found[0] <= len(data) + (4 << 20)


@pytest.mark.parametrize("kind", FRAMES)
def test_events_behind_a_check_are_those_of_the_decoder(written, kind):
    pytest.importorskip("aedat")
    compression, frame = FRAMES[kind]
    found = import_events(written(compression, frame(events_packet(3000)), frame(events_packet(2000))))
    assert len(found.events.t) == 5000


def zeros_frame(kind, size):
    """A frame of so many zeros, written a megabyte at a time."""
    if kind == "zstd-run":  # blocks of one repeated byte
        blocks = [
            struct.pack("<I", (1 << 17) << 3 | 2 | (k == size >> 17))[:3] + b"\0"
            for k in range((size >> 17) + 1)
        ]
        return struct.pack("<IBB", 0xFD2FB528, 0, 56) + b"".join(blocks)
    compress = zstd_frame if kind == "zstd" else lz4_frame
    return compress(bytes(1 << 20)) * (size >> 20)


@pytest.mark.parametrize("kind", ["zstd", "zstd-run", "lz4"])
def test_a_bomb_is_refused_before_it_takes_memory(written, kind):
    path = written(LZ4 if kind == "lz4" else ZSTD, zeros_frame(kind, MOST_PACKET_BYTES + (2 << 20)))
    assert path.stat().st_size < 10_000_000
    pytest.importorskip("aedat")
    tracemalloc.start()
    try:
        with pytest.raises(RecordingFileError, match="unpacks to 512 MiB or more; at most 512 MiB are read"):
            import_events(path)
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    ("compression", "payload", "what"),
    [
        (ZSTD, struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 56, 1 << 60), "unpacks to 1099511627776 MiB"),
        (LZ4, struct.pack("<IBBQB", 0x184D2204, 0x68, 0x40, 1 << 50, 0), "unpacks to 1073741824 MiB"),
        (ZSTD, b"\x25\xb5\x2f\xfd" + bytes(40), "is not Zstandard"),  # a format from before version 1
        (LZ4, b"\x02\x21\x4c\x18" + bytes(40), "is not LZ4"),
        (ZSTD, struct.pack("<IBB", 0xFD2FB528, 0, 56) + b"\x06\0\0" * 9, "is not Zstandard"),
        (ZSTD, struct.pack("<IBB", 0xFD2FB528, 0, 56) + b"\0\0\0" * 200_000, "are damaged"),
        (LZ4, struct.pack("<IBBBI", 0x184D2204, 0x60, 0x40, 0, 0x7FFFFFFF) + bytes(9), "are damaged"),
        (9, b"", "compression 9 of this AEDAT4 file is unknown"),
    ],
)
def test_what_a_frame_states_wrongly_is_told(written, compression, payload, what):
    with pytest.raises(UnreadablePacket, match=what):
        list(checked_packets(written(compression, payload)))


def test_sizes_beyond_the_file_are_told(tmp_path):
    path = tmp_path / "a.aedat4"
    path.write_bytes(MAGIC + struct.pack("<I", 0xFFFFFFF0))
    with path.open("r+b") as file:
        file.truncate(10 << 30)
    with pytest.raises(UnreadablePacket, match="header of this AEDAT4 file states 4294967280 bytes"):
        list(checked_packets(path))
    path.write_bytes(header(NONE) + struct.pack("<II", 0, 0xFFFFFFF0))
    with pytest.raises(UnreadablePacket, match=r"packet at byte \d+ of this AEDAT4 file is cut off"):
        list(checked_packets(path))
    with path.open("r+b") as file:
        file.truncate(10 << 30)
    with pytest.raises(UnreadablePacket, match="unpacks to 4095 MiB or more"):
        list(checked_packets(path))


def test_the_packets_end_where_the_header_says(written, monkeypatch):
    monkeypatch.setattr(aedat4_packets, "MOST_PACKET_BYTES", 100)
    path = written(NONE, b"a" * 100, b"b" * 101)
    found = checked_packets(path)
    assert next(found) == 100
    with pytest.raises(UnreadablePacket):
        next(found)
    data = bytearray(path.read_bytes())
    at = len(header(NONE)) + 108
    position = data.index(struct.pack("<q", -1))
    data[position : position + 8] = struct.pack("<q", at)
    path.write_bytes(data)
    assert list(checked_packets(path)) == [100]
