"""RAW files: headers of all makes, events out of them, and files that are something else."""

import os
import tracemalloc
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.camera import CameraIdentity
from drivers.camera.raw_file import RawFile
from drivers.camera.raw_header import MAX_HEADER_BYTES, parse_header, render_header
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

HEADER = (
    b"% evt 3.0\n% format EVT3;height=720;width=1280\n% geometry 1280x720\n% serial_number 00051234\n% end\n"
)
WORDS = [0x8001, 0x6002, 0x0005, 0x2803, 0xA001, 0x6005, 0x2004]
CAMERA = CameraIdentity("Prophesee", "EVK4", "IMX636", "00050423", "1.2", 1280, 720)


@pytest.fixture
def raw(tmp_path):
    """Writes a RAW file of these words."""

    def write(words=WORDS, header=HEADER, tail=b""):
        path = tmp_path / "some.raw"
        path.write_bytes(header + np.array(words, "<u2").tobytes() + tail)
        return path

    return write


def test_a_recording_reads_back_what_its_words_say(raw):
    recording = RawFile.open(raw())
    events, triggers = recording.read()
    assert (recording.width, recording.height, recording.serial) == (1280, 720, "00051234")
    assert [field.tolist() for field in events] == [[4098, 4101], [3, 4], [5, 5], [1, 0]]
    assert [field.tolist() for field in triggers] == [[4098], [1], [0]]
    assert recording.triggers().t.tolist() == [4098]


def test_a_scan_tells_counts_times_and_size(raw):
    path = raw()
    scan = RawFile.open(path).scan()
    assert (scan.events, scan.on_events, scan.triggers) == (2, 1, 1)
    assert (scan.first_t_us, scan.last_t_us) == (4098, 4101)
    assert scan.bytes == path.stat().st_size
    assert not scan.truncated


def test_counts_are_the_events_of_each_pixel(raw):
    image = RawFile.open(raw()).counts()
    assert image.shape == (2, 720, 1280)
    assert image.sum() == 2
    assert image[1, 5, 3] == image[0, 5, 4] == 1


def test_a_long_file_is_streamed_in_little_memory(raw):
    words = np.full(12_000_000, 0x2007, "<u2")
    words[:3] = 0x8001, 0x6002, 0x0005
    recording = RawFile.open(raw(words))
    list(RawFile.open(raw(WORDS)).chunks())  # compiled before memory is watched
    raw(words)
    tracemalloc.start()
    assert sum(len(chunk.t) for chunk in recording.chunks(max_events=100_000)) == 12_000_000 - 3
    assert recording.scan().events == 12_000_000 - 3
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8e6


@pytest.mark.parametrize("kept", range(2 * len(WORDS) + 1))
def test_a_file_cut_anywhere_is_readable_up_to_there(raw, kept):
    path = raw()
    os.truncate(path, len(HEADER) + kept)
    recording = RawFile.open(path)
    assert recording.scan().truncated == (kept % 2 == 1)
    assert len(recording.read()[0].t) == sum(kept >= end for end in (8, 14))


def test_an_offset_beyond_the_first_block_is_right(raw):
    words = np.full(600_000, 0x2007)
    words[:3] = 0x8001, 0x6002, 0x0005
    words[555_555] = 0x9000
    with pytest.raises(RecordingCorrupt) as caught:
        RawFile.open(raw(words)).scan()
    assert caught.value.offset == len(HEADER) + 2 * 555_555


# ---------------------------------------------------------------- headers


@pytest.mark.parametrize(
    "header",
    [
        b"% format EVT3;height=720;width=1280\n",
        b"% evt 3.0\n% system_ID 49\n",
        b"% evt 3.0\n% geometry 1280x720\n",
        b"% evt 3.0\n% height 720\n% width 1280\n% geometry 1280x720\n",
        b"% evt 3.0\n% system_ID 48\n",
        b"% format evt3;height=720;width=1280\n",
        b"% format EVT3;width=1280;height=720\r\n% end\r\n",
        b"%  format   EVT3;height=720;width=1280 \n% my_own key with  text\n% end\n",
    ],
)
def test_headers_of_all_makes_are_understood(raw, header):
    recording = RawFile.open(raw(header=header))
    assert (recording.width, recording.height) == (1280, 720)
    assert recording.scan().events == 2


HD, VGA = (1280, 720), (640, 480)


@pytest.mark.parametrize(
    ("system", "encoding", "size"),
    [
        *((system, "EVT2", VGA) for system in (21, 23, 25, 28, 29, 33, 34, 35, 41, 151, 153, 161, 162)),
        *((system, "EVT2", HD) for system in (26, 31, 39)),
        *((system, "EVT3", HD) for system in (30, 46, 48, 49, 50, 53, 58, 66)),
        *((system, "EVT3", (640, 512)) for system in (52, 54)),
        *((system, "EVT21", (320, 320)) for system in (59, 64)),
        (40, "EVT3", VGA),
    ],
)
@pytest.mark.parametrize("evt", ["", "% evt 2.0\n", "% evt 3.0\n"])
def test_the_number_of_the_system_tells_what_the_header_leaves_out(system, encoding, size, evt):
    start = f"% Date 2020-09-25 07:48:29\n{evt}% integrator_name Prophesee\n% system_ID {system}\n".encode()
    header = parse_header(start, where="x", evt3_only=False)
    stated = {"": encoding, "% evt 2.0\n": "EVT2", "% evt 3.0\n": "EVT3"}[evt]
    assert (header.encoding, (header.width, header.height)) == (stated, size)


def test_the_number_of_another_makers_system_tells_nothing():
    start = b"% evt 3.0\n% integrator_name CenturyArks\n% system_ID 49\n"
    with pytest.raises(NotARecording, match="sensor's size"):
        parse_header(start, where="x")
    header = parse_header(start, where="x", sensor_size=(640, 480))
    assert (header.width, header.height) == (640, 480)


def test_a_size_that_the_user_states_must_not_contradict_the_header():
    start = b"% evt 3.0\n% geometry 1280x720\n"
    assert parse_header(start, where="x", sensor_size=(1280, 720)).width == 1280
    with pytest.raises(NotARecording, match=r"1280 x 720, .* 640 x 480"):
        parse_header(start, where="x", sensor_size=(640, 480))


@pytest.mark.parametrize(
    ("lines", "encoding"),
    [
        (b"% format EVT21;endianness=legacy;height=720;width=1280\n", "EVT21-legacy"),
        (b"% format EVT21;height=720;width=1280\n% endianness legacy\n", "EVT21-legacy"),
        (b"% format EVT21;height=720;width=1280\n% system_ID 49\n", "EVT21-legacy"),
        (b"% format EVT21;height=320;width=320\n% system_ID 64\n", "EVT21"),
        (b"% format EVT21;endianness=little;height=720;width=1280\n% system_ID 49\n", "EVT21"),
        (b"% evt 2.1\n% geometry 320x320\n% system_ID -1\n", "EVT21"),
    ],
)
def test_the_order_of_the_halves_of_evt21_is_that_of_the_header_or_of_the_system(lines, encoding):
    assert parse_header(lines, where="x", evt3_only=False).encoding == encoding


def test_runs_of_white_space_count_as_one_and_unknown_keys_stay():
    header = parse_header(b"% format EVT3;height=4;width=6\n% lens   f 12   mm\n% end\n", where="x")
    assert header.fields["lens"] == "f 12 mm"
    assert (header.width, header.height) == (6, 4)


def test_words_that_look_like_a_header_line_are_words_after_its_end():
    start = b"% format EVT3;height=720;width=1280\n% end\n% \n\n"
    assert parse_header(start, where="x").size_bytes == len(start) - 4


def zip_start(*names):
    return b"".join(b"PK\x03\x04" + bytes(26) + name + b"\1\2" for name in names)


@pytest.mark.parametrize(
    ("start", "message"),
    [
        (b"", "it is empty"),
        (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        (b"% Data file containing CD events.\n% Version 2\n", "a DAT file"),
        (b"name: three poses\nsteps: []\n", "a text file.* columns named t, x, y and p"),
        ("x;y;Polarit\u00e4t;Zeit\n".encode("cp1252"), "a text file"),
        (b"<!DOCTYPE html>\n<html>", "a web page.*Raw"),
        (b"version https://git-lfs.github.com/spec/v1\noid", "a pointer of Git LFS"),
        (zip_start(b"[Content_Types].xml", b"_rels/.rels", b"xl/workbook.xml"), "office program.*CSV"),
        (zip_start(b"mimetypeapplication/vnd.oasis.opendocument.spreadsheet"), "office program.*CSV"),
        (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "office program.*CSV"),
        (b"\0" * 100, "nothing but zeros"),
        (b"#!AER-DAT2.0\r\n# created by v2e\r\n\0\1", "binary data.* AEDAT 4.* faery"),
        (b"MATLAB 5.0 MAT-file, Platform", "a file of MATLAB. Write"),
        (b"\xff\xfet\0,\0x\0", "text in UTF-16.*UTF-8"),
        (b"% evt 4.0\n% format EVT4;height=720;width=1280\n", "The file holds EVT4"),
        # OpenEB, i_events_stream.cpp: the header of an index is that of its recording, and more
        (b"% format EVT3;height=720;width=1280\n% index_version 2.0\n% end\n", "index .* beside"),
        (b"% index version 2.0\n% magic_number 12345\n% ts_shift_us 0\n% end\n", "index .* beside"),
        (b"\x01\x80\x02\x60", "binary data without a RAW header.* with their headers"),
        (b"% format EVT21;height=720;width=1280\n% end\n", "The file holds EVT21"),
        (b"% evt 2.0\n% format EVT2;height=720;width=1280\n% end\n", "The file holds EVT2;"),
        (b"% geometry 640x480\n% end\n", "encoding .* header"),
        (b"% evt 3.0\n% end\n", "does not state the sensor's size"),
        (b"% format EVT3;height=720;width=1280\n% geometry 640x480\n", "1280 x 720, geometry .* 640 x 480"),
        (b"% format EVT3;height=0;width=1280\n", "'1280' x '0'"),
        (b"% evt 3.0\n% geometry wide\n", "'wide' x ''"),
        (b"% format EVT3;height=720;width=1280", "ends within its header"),
    ],
)
def test_other_files_are_told_by_what_they_are(tmp_path, start, message):
    path = tmp_path / "what.raw"
    path.write_bytes(start)
    with pytest.raises(NotARecording, match=message) as caught:
        RawFile.open(path)
    assert "what.raw" in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("line", [b"% a b\n", b"% a bcd\n"])
def test_an_endless_header_is_given_up(tmp_path, line):
    path = tmp_path / "endless.raw"
    path.write_bytes(line * MAX_HEADER_BYTES)
    with pytest.raises(NotARecording, match="65536 bytes"):
        RawFile.open(path)


def test_a_missing_file_and_a_folder_are_told_apart(tmp_path):
    with pytest.raises(RecordingFileError, match="no such file"):
        RawFile.open(tmp_path / "none.raw")
    with pytest.raises(NotARecording, match="folder"):
        RawFile.open(tmp_path)


def test_a_file_without_permission_says_so(raw, monkeypatch):
    path = raw()

    def refuse(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.open", refuse)  # a mode would not keep root out
    with pytest.raises(RecordingFileError, match="no permission to read"):
        RawFile.open(path)


def test_a_new_header_reads_back(tmp_path):
    path = tmp_path / "new.raw"
    path.write_bytes(render_header(CAMERA, datetime(2026, 11, 20, 4, 5, 6, tzinfo=UTC)))
    recording = RawFile.open(path)
    assert recording.serial == "00050423"
    assert recording.header["date"] == "2026-11-20 04:05:06"
    assert recording.header["sensor_name"] == "IMX636"
    assert (recording.width, recording.height) == (1280, 720)
    assert recording.scan().events == 0


def test_a_name_with_a_line_end_cannot_forge_a_header_line():
    camera = CameraIdentity("Mine\n% format EVT2", "EVK4", "IMX636", "1", "", 1280, 720)
    header = parse_header(render_header(camera, datetime(2026, 1, 1, tzinfo=UTC)), where="x")
    assert header.fields["camera_integrator_name"] == "Mine % format EVT2"
    assert header.width == 1280


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=300), st.booleans())
def test_no_bytes_whatever_make_it_fail_in_another_way(tmp_path, data, with_header):
    path = tmp_path / "fuzz.raw"
    path.write_bytes((HEADER if with_header else b"% ") + data)
    try:
        recording = RawFile.open(path)
        events, _ = recording.read()
    except RecordingFileError:
        return
    assert len(events.t) <= 6 * path.stat().st_size


def test_a_recording_that_vanishes_is_told(tmp_path):
    path = tmp_path / "a.raw"
    path.write_bytes(b"% format EVT3;height=720;width=1280\n% end\n\x01\x80")
    recording = RawFile.open(path)
    path.unlink()
    for look in (recording.scan, lambda: recording.truncated):
        with pytest.raises(RecordingFileError, match="no such file"):
            look()
