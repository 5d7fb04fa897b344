"""Recordings of other programs: ROS bags; each written by a program nobody here wrote."""

import sqlite3
from contextlib import closing, suppress

import numpy as np
import pytest
from imported import import_events
from made_event_files import assert_same, dat_rows, evt21_words, some_events

from drivers.camera.event_arrays import ReadingChoices
from drivers.camera.formats.event_conversion import convert
from drivers.camera.raw_file import RawFile
from drivers.errors import NotARecording, RecordingCorrupt, RecordingFileError

ORIGIN_US = 1_700_000_000_000_000


# ------------------------------------------------------------ ROS


PACKET = "event_camera_msgs/msg/EventPacket"


def bag(path, version, rows, kind, *, name=PACKET, data=None, topics=("/events",), numbers=(0,)):
    """Write a bag with the package rosbags, a message for each of the numbers; return the path to read."""
    pytest.importorskip("rosbags")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    from bench.extras.event_files.ros_bag import DEFINITIONS

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    for defined, text in DEFINITIONS.items():
        store.register(get_types_from_msg(text, defined))
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](sec=ORIGIN_US // 1_000_000, nanosec=0)
    fields = {"stamp": stamp, "frame_id": "camera"} | ({"seq": 0} if version == 1 else {})
    header = types["std_msgs/msg/Header"](**fields)
    if kind == "struct":
        package = name.split("/")[0] if name.endswith("EventArray") else "dvs_msgs"
        name = f"{package}/msg/EventArray"
        if name not in types:
            of_dvs = DEFINITIONS["dvs_msgs/msg/EventArray"].replace("dvs_msgs", package)
            store.register(get_types_from_msg(DEFINITIONS["dvs_msgs/msg/Event"], f"{package}/msg/Event"))
            store.register(get_types_from_msg(of_dvs, name))
        event, time = types[f"{package}/msg/Event"], types["builtin_interfaces/msg/Time"]
        whole = []
        for row in rows:
            sec, us = divmod(int(row["t"]) + ORIGIN_US, 10**6)
            stamp = time(sec=sec, nanosec=us * 1000)
            whole.append(event(x=int(row["x"]), y=int(row["y"]), ts=stamp, polarity=bool(row["on"])))
        message = types[name](header=header, height=480, width=640, events=whole)
    else:
        message = types[name](
            header=header,
            height=480,
            width=640,
            seq=0,
            time_base=ORIGIN_US * 1000,
            encoding=kind,
            is_bigendian=False,
            events=np.frombuffer(data or evt21_words(rows), np.uint8),
        )
    from rosbags import rosbag1, rosbag2

    opened = rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=9)
    serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
    with opened as writer:
        for topic in topics:
            connection = writer.add_connection(topic, name, typestore=store)
            for message.seq in numbers:
                writer.write(connection, ORIGIN_US * 1000, serialize(message, name))
    return path


@pytest.mark.parametrize("version", [1, 2])
@pytest.mark.parametrize("kind", ["struct", "evt21"])
def test_bags_of_both_versions(tmp_path, version, kind):
    rows = some_events(500)
    path = bag(tmp_path / ("a.bag" if version == 1 else "a"), version, rows, kind)
    imported = import_events(path)
    assert (imported.width, imported.height) == (640, 480)
    begin_us = 0 if kind == "evt21" else ORIGIN_US  # words have the camera's own clock
    assert_same(imported, rows, int(imported.header["time_origin_us"]) - begin_us)
    assert imported.header["ros_topic"] == "/events"


def without_definitions(folder):
    """A bag of ROS 2 before Iron, which knows the names of its messages alone."""
    with closing(sqlite3.connect(next(folder.glob("*.db3")))) as database:
        database.execute("delete from message_definitions")
        database.commit()
    return folder


@pytest.mark.parametrize("package", ["dvs_msgs", "prophesee_event_msgs"])
def test_bags_without_definitions_are_read_where_the_messages_are_known(tmp_path, package):
    rows = some_events(60)
    name = f"{package}/msg/EventArray"
    imported = import_events(without_definitions(bag(tmp_path / "a", 2, rows, "struct", name=name)))
    assert_same(imported, rows, int(imported.header["time_origin_us"]) - ORIGIN_US)


def test_a_bag_without_definitions_of_unknown_messages_is_not_called_damaged(tmp_path):
    name = "own_msgs/msg/EventArray"
    rows = some_events(20)
    whole = bag(tmp_path / "a", 2, rows, "struct", name=name)
    assert len(import_events(whole).events.t) == 20
    with pytest.raises(NotARecording, match=f"{name}.*ros2 bag convert"):
        import_events(without_definitions(whole))


def test_the_older_name_of_event_packets_is_read(tmp_path):
    rows = some_events(500)
    path = bag(tmp_path / "a.bag", 1, rows, "evt21", name="event_array_msgs/msg/EventArray")
    assert_same(import_events(path), rows)


@pytest.mark.parametrize("version", [1, 2])
def test_one_of_two_topics_of_a_bag_is_chosen(tmp_path, version):
    rows = some_events(60)
    target = tmp_path / ("a.bag" if version == 1 else "a")
    path = bag(target, version, rows, "struct", topics=("/left/events", "/right/events"))
    with pytest.raises(NotARecording, match=r"/left/events, /right/events\. Choose one"):
        import_events(path)
    for name in ("/right/events", "left/events"):
        imported = import_events(path, ReadingChoices(stream=name))
        assert_same(imported, rows, int(imported.header["time_origin_us"]) - ORIGIN_US)
        assert imported.header["ros_topic"].strip("/") == name.strip("/")


@pytest.mark.parametrize("numbers", [(4, 5), (4, 4), (9, 0)])
def test_messages_that_ros_lost_are_told_where_words_depend_on_them(tmp_path, numbers):
    """A driver that starts again counts from 0; some count nothing."""
    rows = some_events(60)
    path = bag(tmp_path / "a.bag", 1, rows, "evt21", numbers=(4, 9))
    with pytest.raises(NotARecording, match=r"4 messages of /events .* number 4"):
        import_events(path)
    assert len(import_events(bag(tmp_path / "b.bag", 1, rows, "evt21", numbers=numbers)).events.t)


def test_the_folder_of_a_ros_2_bag_is_converted_and_a_file_of_it_stands_for_it(tmp_path):
    folder = bag(tmp_path / "a", 2, some_events(80), "evt21")
    assert len(import_events(next(folder.glob("*.db3"))).events.t) == 80
    assert convert(folder, tmp_path / "a.raw", "raw").events == 80
    header = RawFile.open(tmp_path / "a.raw").header
    assert (header["date"], header["ros_topic"]) == ("2023-11-14 22:13:20", "/events")
    assert "system_ID" not in header
    assert "sensor_generation" not in header


@pytest.mark.parametrize(("version", "program"), [(1, "rosbag"), (2, "ros2 bag")])
def test_a_bag_that_was_not_closed_or_lacks_a_file_is_told_with_the_way_on(tmp_path, version, program):
    path = bag(tmp_path / ("a.bag" if version == 1 else "a"), version, some_events(80), "evt21")
    if version == 1:
        path.write_bytes(path.read_bytes()[:-500])
    else:
        next(path.glob("*.db3")).unlink()
    with pytest.raises(NotARecording, match=f" {program} reindex {path.name}"):
        import_events(path)


def test_an_encoding_that_cannot_be_read_is_named(tmp_path):
    path = bag(tmp_path / "a.bag", 1, some_events(5), "libcaer_cmp")
    with pytest.raises(RecordingFileError, match="'libcaer_cmp'"):
        import_events(path)


def test_malformed_words_in_a_bag_are_told_with_their_place_once(tmp_path):
    path = bag(tmp_path / "a.bag", 1, some_events(5), "evt3")
    with pytest.raises(RecordingCorrupt, match=r"640 x 480 px \(byte 30\)") as caught:
        import_events(path)
    assert caught.value.offset == 30


# ------------------------------------------------------------ hostile files

HOSTILE = {
    "aedat4-empty": b"#!AER-DAT4.0\r\n",
    "aedat4-random": b"#!AER-DAT4.0\r\n" + np.random.default_rng(1).bytes(5000),
    "aedat4-huge-header": b"#!AER-DAT4.0\r\n" + b"\xff\xff\xff\x7f" * 4,
    "rosbag1-empty": b"#ROSBAG V2.0\n",
    "rosbag1-random": b"#ROSBAG V2.0\n" + np.random.default_rng(1).bytes(5000),
    "rosbag1-huge-record": b"#ROSBAG V2.0\n" + b"\xff\xff\xff\x7f" * 4,
    "mcap-random": b"\x89MCAP0\r\n" + np.random.default_rng(1).bytes(5000),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_files_are_refused_with_one_message(tmp_path, name):
    pytest.importorskip("aedat" if name.startswith("aedat4") else "rosbags")
    path = tmp_path / f"bad.{'mcap' if name.startswith('mcap') else 'raw'}"
    path.write_bytes(HOSTILE[name])
    with pytest.raises(RecordingFileError) as caught:
        import_events(path)
    assert str(path) in str(caught.value)
    assert caught.value.remedy


@pytest.mark.parametrize("make", ["dat", "bag"])
def test_files_cut_off_anywhere_end_in_one_message_or_whole_events(tmp_path, make):
    rows, path = some_events(300), tmp_path / f"a.{make}"
    if make == "dat":
        path.write_bytes(dat_rows(rows))
    else:
        bag(path, 1, rows, "evt21")
    whole = path.read_bytes()
    cut = tmp_path / f"cut.{make}"
    for length in np.random.default_rng(2).integers(0, len(whole), 8):
        cut.write_bytes(whole[:length])
        with suppress(RecordingFileError):
            assert len(import_events(cut).events.t) <= len(rows)
        cut.unlink()
