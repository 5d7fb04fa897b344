"""AEDAT4, read by its library in another process: its events, and one message for whatever the library does."""

import os
import resource
import struct
import subprocess
import sys
from contextlib import suppress

import numpy as np
import pytest
from imported import import_events

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats import library_process
from drivers.camera.formats.event_conversion import convert
from drivers.camera.raw_file import RawFile
from drivers.errors import CameraSoftwareMissing, NotARecording, RecordingFileError

pytest.importorskip("aedat")

READER = "bench.extras.event_files.aedat4:open_aedat4"
NONE, LZ4, ZSTD = 0, 1, 3
RISING, FALLING, OF_A_FRAME = 1, 2, 8
MAGIC = b"#!AER-DAT4.0\r\n"
BEGIN_US = 1_700_000_000_000_000


def header(compression, *sizes):
    """A flatbuffer: root, vtable of three fields, table, text; a stream of events of each of these sizes, and one of edges."""
    streams = "".join(
        f'<node name="{number}"><attr key="typeIdentifier">EVTS</attr><node name="info">'
        f'<attr key="sizeX">{width}</attr><attr key="sizeY">{height}</attr></node></node>'
        for number, (width, height) in enumerate(sizes or [(640, 480)])
    )
    streams += '<node name="9"><attr key="typeIdentifier">TRIG</attr></node>'
    text = f'<dv version="2.0"><node name="outInfo">{streams}</node></dv>'
    vtable = struct.pack("<HHHHH", 10, 20, 4, 12, 8) + b"\0\0"
    table = struct.pack("<iiI", 12, compression, 12) + struct.pack("<q", -1)
    body = struct.pack("<I", 16) + vtable + table + struct.pack("<I", len(text)) + text.encode() + b"\0"
    return MAGIC + struct.pack("<I", len(body)) + body


def packet(payload, stream=0):
    return struct.pack("<II", stream, len(payload)) + payload


def events_packet(n):
    """A size prefixed flatbuffer of n events."""
    rows = np.zeros(n, [("t", "<i8"), ("x", "<i2"), ("y", "<i2"), ("on", "?"), ("pad", "V3")])
    at = np.arange(n)
    rows["t"], rows["x"], rows["y"], rows["on"] = BEGIN_US + at, at % 640, at % 480, at % 3 == 0
    vtable = struct.pack("<HHH", 6, 8, 4) + b"\0\0"
    vector = struct.pack("<I", n) + rows.tobytes()
    # prefix, root, identifier, vtable, table, padding, vector: its elements lie at a multiple of 8
    body = struct.pack("<I", 16) + b"EVTS" + vtable + struct.pack("<iI", 8, 8) + b"\0" * 4 + vector
    return struct.pack("<I", len(body)) + body


def edges_packet(*edges):
    """A size prefixed flatbuffer of an odd number of triggers: a table for each, of its time and its source."""
    shared = 28 + 4 * len(edges)  # the vtable of every trigger, behind the vector of their places
    places = [shared + 8 + 16 * number for number in range(len(edges))]
    body = struct.pack("<I4sHHHHiII", 16, b"TRIG", 6, 8, 4, 0, 8, 4, len(edges))
    body += b"".join(struct.pack("<I", place - 28 - 4 * number) for number, place in enumerate(places))
    body += struct.pack("<HHHH", 8, 16, 4, 12)
    for place, (t_us, source) in zip(places, edges, strict=True):
        body += struct.pack("<iqb3x", place - shared, BEGIN_US + t_us, source)
    return struct.pack("<I", len(body)) + body


@pytest.fixture
def written(tmp_path):
    def write(compression, *packets):
        path = tmp_path / "a.aedat4"
        path.write_bytes(header(compression) + b"".join(map(packet, packets)))
        return path

    return write


def lz4_frame(data):
    return pytest.importorskip("lz4.frame").compress(data)


def zstd_frame(data):
    return pytest.importorskip("backports.zstd").compress(data)


FRAMES = {"lz4": (LZ4, lz4_frame), "zstd": (ZSTD, zstd_frame), "none": (NONE, bytes)}


@pytest.mark.parametrize("kind", FRAMES)
def test_events_of_every_compression_are_read(written, kind):
    compression, frame = FRAMES[kind]
    imported = import_events(written(compression, frame(events_packet(3000)), frame(events_packet(2000))))
    assert len(imported.events.t) == 5000


def test_places_polarities_and_edges_of_the_signal_are_read_and_other_triggers_left_out(tmp_path):
    edges = edges_packet((100, RISING), (200, OF_A_FRAME), (300, FALLING))
    (tmp_path / "a.aedat4").write_bytes(header(NONE) + packet(events_packet(700)) + packet(edges, 9))
    imported, at = import_events(tmp_path / "a.aedat4"), np.arange(700)
    assert imported.events.t.tolist() == (1_000_000 + at).tolist()
    assert imported.events.x.tolist() == (at % 640).tolist()
    assert imported.events.y.tolist() == (at % 480).tolist()
    assert imported.events.p.tolist() == (at % 3 == 0).astype(int).tolist()
    assert imported.triggers.t.tolist() == [1_000_100, 1_000_300]
    assert imported.triggers.value.tolist() == [1, 0]


def test_one_of_two_streams_is_chosen_and_has_its_own_size(tmp_path):
    path = tmp_path / "a.aedat4"
    packets = (packet(events_packet(n), stream) for stream, n in enumerate((30, 20)))
    path.write_bytes(header(NONE, (640, 480), (346, 260)) + b"".join(packets))
    with pytest.raises(NotARecording, match="2 streams of events"):
        import_events(path)
    streams = [import_events(path, ReadingChoices(stream=name)) for name in ("0", "1")]
    assert [(stream.width, len(stream.events.t)) for stream in streams] == [(640, 30), (346, 20)]


def test_the_date_stands_in_a_converted_recording_and_nothing_else(written, tmp_path):
    convert(written(NONE, events_packet(200)), tmp_path / "a.raw", "raw")
    recording = RawFile.open(tmp_path / "a.raw")
    assert recording.header == {
        "date": "2023-11-14 22:13:20",
        "time_origin_us": str(BEGIN_US - 1_000_000),
        "evt": "3.0",
        "format": "EVT3;height=480;width=640",
        "geometry": "640x480",
        "converted_from": "a.aedat4; not the bytes of a camera",
    }
    assert recording.read()[0].t.tolist() == list(range(1_000_000, 1_000_200))


@pytest.mark.parametrize("length", [15, 100, 400, 1500, 4000])
def test_a_file_that_was_cut_off_ends_in_one_message_or_whole_events(written, length):
    path = written(NONE, events_packet(100), events_packet(200))
    path.write_bytes(path.read_bytes()[:length])
    with suppress(RecordingFileError):
        assert len(import_events(path).events.t) in {0, 100}


def zeros_frame(size):
    """A frame of so many zeros, in blocks of one repeated byte."""
    last = size >> 17
    blocks = [struct.pack("<I", (1 << 17) << 3 | 2 | (k == last))[:3] + b"\0" for k in range(last + 1)]
    return struct.pack("<IBB", 0xFD2FB528, 0, 56) + b"".join(blocks)


def most_kb_of_reader(path):
    """Memory that reading takes, started from a small process: a program begins with the size of who starts it."""
    program = (
        "import resource, subprocess, sys\n"
        f"command = [sys.executable, '-m', 'drivers.camera.formats.library_reader', '{READER}', sys.argv[1], '{{}}']\n"
        "subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)\n"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-c", program, str(path)]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(ran.stdout)


def test_a_bomb_ends_in_one_message_and_takes_no_memory_here(written):
    path = written(ZSTD, zeros_frame(3 << 30))
    assert path.stat().st_size < 20_000_000
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(RecordingFileError, match="holds no readable events"):
        import_events(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 50_000
    assert most_kb_of_reader(path) < library_process.MOST_BYTES >> 10


@pytest.mark.parametrize(
    "data",
    [
        header(ZSTD) + packet(struct.pack("<IBBQ", 0xFD2FB528, 0xC0, 56, 1 << 60)),
        header(LZ4) + packet(struct.pack("<IBBQB", 0x184D2204, 0x68, 0x40, 1 << 50, 0)),
        header(ZSTD) + packet(b"\x25\xb5\x2f\xfd" + bytes(40)),
        header(NONE) + struct.pack("<II", 0, 0xFFFFFFF0),
        header(9) + packet(b""),
        MAGIC + struct.pack("<I", 0xFFFFFFF0) + bytes(50),
    ],
)
def test_what_a_file_states_wrongly_is_refused(tmp_path, data):
    path = tmp_path / "a.aedat4"
    path.write_bytes(data)
    with pytest.raises(RecordingFileError) as caught:
        import_events(path)
    assert caught.value.where == str(path)
    assert caught.value.remedy


def test_a_package_that_is_missing_is_named(tmp_path, monkeypatch):
    (tmp_path / "aedat.py").write_text("raise ModuleNotFoundError(name='aedat.core')")
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "a.aedat4"
    path.write_bytes(header(NONE))
    with pytest.raises(CameraSoftwareMissing, match=r"package aedat\.") as caught:
        import_events(path)
    assert caught.value.where == str(path)
    assert caught.value.remedy == "Install it: pip install aedat"
