"""Bad input at the command line: one clear message that names place and remedy, a status that is not 0, nothing made."""

import io
import shutil
from pathlib import Path

import pytest
from calling import ended
from station_texts import PLAIN

SEQUENCE = (Path(__file__).parents[2] / "sequences" / "three_pose.yaml").read_text()


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


def write(name, text):
    Path(name).write_text(text)
    return name


FILES = [
    (("frequency_hz: 60", "frequency_hz: sixty"), (), "sequence.yaml:8:43", "number"),
    ((), ("simulation: {}", "# no simulation"), "station.yaml:12:9", "simulation section"),
]


@pytest.mark.parametrize(("in_sequence", "in_station", "place", "words"), FILES)
def test_faults_of_files_are_placed_and_nothing_is_made(capsys, in_sequence, in_station, place, words):
    sequence = write("sequence.yaml", SEQUENCE.replace(*in_sequence) if in_sequence else SEQUENCE)
    station = write("station.yaml", PLAIN.replace(*in_station) if in_station else PLAIN)
    status, (_, message) = ended(capsys, "run", sequence, "--station", station, "--output", "out")
    assert status == 2
    assert place in message
    assert words in message
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("in_station", "words", "serials"),
    [
        (("serial: 100102", "serial: 999999"), (), ("999999", "100102")),
        (("", ""), ("--expect-serial", "00099999"), ("00099999", "00050423")),
    ],
    ids=["axis", "camera"],
)
def test_another_device_than_the_expected_one_is_refused_before_anything_moves(
    capsys, in_station, words, serials
):
    station = write("station.yaml", PLAIN.replace(*in_station))
    status, (_, message) = ended(capsys, "run", "three_pose", "--station", station, "--output", "out", *words)
    assert status == 1
    assert all(serial in message for serial in serials)
    wire = Path("out/wire.jsonl").read_text()
    assert '"home' not in wire
    assert " move " not in wire


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--expect-serial", "-"], "No serial number was scanned."),
        (["--expect-serial", "a\tb"], "is no serial number."),
        (["--expect-serial", "5", "--set", "station.camera.serial=6"], "--set"),
    ],
)
def test_a_text_that_is_no_serial_number_is_one_clear_error_and_nothing_is_written(
    capsys, monkeypatch, words, message
):
    monkeypatch.setattr("sys.stdin", io.StringIO(""))
    status, (out, err) = ended(capsys, "run", "three_pose", "-s", "simulated", "-o", "out", *words)
    assert (status, out) == (2, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert not Path("out").exists()


def test_recordings_that_are_none_or_cut_short_are_named(capsys, evk4_recording):
    write("text.raw", "this is no recording")
    whole = evk4_recording.read_bytes()
    Path("half.raw").write_bytes(whole[:-100_001])  # words have two bytes
    cut = "cut in the middle of a word, and used up to there: half.raw."
    for name, words, status in (("text.raw", "not a", 2), ("half.raw", cut, 1)):
        end, (_, message) = ended(capsys, "calibrate", name)
        assert end == status
        assert name in message
        assert words in message.lower()


def test_a_changed_sequence_is_not_resumed(capsys):
    station = write("station.yaml", PLAIN.replace("serial: SG0042", "serial: SG9999"))
    assert ended(capsys, "run", "three_pose", "--station", station, "--output", "out")[0] == 1
    shutil.copy("out/sequence.yaml", "keep")
    Path("out/sequence.yaml").write_text(SEQUENCE.replace("window_ms: 33", "window_ms: 50"))
    status, (_, message) = ended(capsys, "resume", "out")
    assert status == 1
    assert "was changed" in message
