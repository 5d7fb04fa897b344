"""`convert` as a person calls it: what a file does not state is said by an option, and an invalid file ends with 2."""

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from running import called

from bench.base.errors import UsageError
from bench.extras.tools.convert import convert
from bench.solve.offline_options import OfflineOptions
from bench.solve.view_sources import view_sources
from drivers.camera.raw_file import RawFile

WORDS = np.array([0x8001, 0x6002, 0x0005, 0x2803, 0xB000, 0x9999, 0x2004], "<u2").tobytes()
NO_SIZE = b"% evt 3.0\n% serial_number 7\n% end\n"


@pytest.fixture
def stereo(tmp_path):
    with h5py.File(tmp_path / "stereo.h5", "w") as file:
        for n, side in enumerate(("left", "right"), 3):
            for name in "txyp":
                file[f"{side}/{name}"] = np.zeros(n, "u1")
    return tmp_path / "stereo.h5"


def run(*words, home):
    ran = called("convert", *words, home=home, status=None)
    return ran.returncode, ran.stdout, ran.stderr


@pytest.mark.parametrize(
    ("content", "given", "words"),
    [(b"#!AER-DAT2.0\r\n", "640x480", "a text file"), (NO_SIZE, "1280", "--sensor-size")],
)
def test_an_invalid_file_or_size_ends_with_2_and_one_message(tmp_path, content, given, words):
    (tmp_path / "a.raw").write_bytes(content)
    status, out, err = run(tmp_path / "a.raw", tmp_path / "b.npz", "--sensor-size", given, home=tmp_path)
    assert (status, out) == (2, "")
    assert words in err
    assert "Traceback" not in err
    assert [path.name for path in tmp_path.iterdir() if path.suffix in {".npz", ".part"}] == []


def test_a_recording_without_a_size_is_copied_with_one_word_for_word(tmp_path):
    (tmp_path / "a.raw").write_bytes(NO_SIZE + WORDS)
    status, out, err = run(tmp_path / "a.raw", tmp_path / "b.raw", "--sensor-size", "1280x720", home=tmp_path)
    assert (status, out) == (0, f"{tmp_path / 'b.raw'}: 2 events, 0 triggers\n")
    assert "left out: 1." in err
    copy = RawFile.open(tmp_path / "b.raw")
    assert (copy.width, copy.height, copy.serial) == (1280, 720, "7")
    assert b"".join(words.tobytes() for words in copy.words()) == WORDS


@pytest.mark.parametrize("option", ["--stream", "--topic"])
def test_one_of_several_streams_is_chosen(stereo, tmp_path, option):
    size = ("--sensor-size", "8x8")
    status, _, err = run(stereo, tmp_path / "a.npz", *size, home=tmp_path)
    assert (status, "left, right" in err) == (2, True)
    status, out, _ = run(stereo, tmp_path / "a.npz", *size, option, "right", home=tmp_path)
    assert (status, out) == (0, f"{tmp_path / 'a.npz'}: 4 events, 0 triggers\n")


def test_what_was_assumed_is_printed_and_the_unit_can_be_said(tmp_path):
    zeros = np.zeros(2000, int)
    np.savez(tmp_path / "a.npz", t=np.arange(2000) * 1000, x=zeros, y=zeros, p=zeros)
    words = (tmp_path / "a.npz", tmp_path / "b.npz", "--sensor-size", "8x8")
    status, _, err = run(*words, home=tmp_path)
    assert (status, "--time-unit ms" in err) == (2, True)
    status, out, err = run(*words, "--time-unit", "ms", home=tmp_path)
    assert (status, out) == (0, f"{tmp_path / 'b.npz'}: 2000 events, 0 triggers, 1999 s\n")
    assert "unit" not in err


def test_many_files_take_the_same_choices(stereo, tmp_path):
    (tmp_path / "other.h5").write_bytes(stereo.read_bytes())
    files = [str(stereo), str(tmp_path / "other.h5"), str(tmp_path / "out")]
    choices = ["--as", "raw", "--stream", "left", "--sensor-size", "8x8"]
    ran = CliRunner().invoke(convert, [*files, *choices], standalone_mode=False)
    assert ran.exception is None
    assert "2 of 2 files converted" in ran.output
    recording = RawFile.open(tmp_path / "out" / "other.raw")
    assert (recording.width, len(recording.read()[0].t)) == (8, 3)


def test_a_file_with_an_unknown_extension_is_named_by_what_it_holds(tmp_path):
    (tmp_path / "a.aedat").write_bytes(b"#!AER-DAT3.1\r\n")
    with pytest.raises(UsageError, match=r"'\.aedat': .*text file.*AEDAT 4"):
        list(view_sources(tmp_path / "a.aedat", OfflineOptions()))


def test_a_ros_2_bag_is_one_recording_not_a_folder_of_files(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {}\n")
    (folder / "bag_0.db3").write_bytes(b"SQLite format 3\0")
    assert [source.path for source in view_sources(folder, OfflineOptions())] == [folder]
