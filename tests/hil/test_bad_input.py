"""Bad input at the command line: one clear message that names place and remedy, a status that is not 0, nothing made."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from station_texts import PLAIN

from bench.commands.cli import main

SEQUENCE = (Path(__file__).parents[2] / "sequences" / "three_pose.yaml").read_text()


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)


def say(capsys, *words):
    """Run a command; return its exit status and what it said on standard error."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    said = capsys.readouterr().err
    assert "Traceback" not in said
    return end.value.code, said


def write(name, text):
    Path(name).write_text(text)
    return name


FILES = [
    (("frequency_hz: 60", "frequency_hz: sixty"), (), "sequence.yaml:8:43", "number"),
    (("window_ms: 33", "windowms: 33"), (), "sequence.yaml:10:12", "window_ms"),
    (("name: Three poses", "name: Three poses\nname: Four"), (), "sequence.yaml:3:1", "duplicate"),
    (("pan_deg: -6", "pan_deg: -60"), (), "sequence.yaml:14:29", "outside"),
    (("poses: three", "poses: four"), (), "sequence.yaml", "four"),
    ((), ("driver: zaber_ascii", "driver: zaber_binary"), "station.yaml", "zaber_ascii"),
    ((), ("serial: 100101", "serial: [1]"), "station.yaml", "serial"),
    ((), ("simulation: {}", "# no simulation"), "station.yaml:12:9", "simulation section"),
]


@pytest.mark.parametrize(("in_sequence", "in_station", "place", "words"), FILES)
def test_faults_of_files_are_placed_and_nothing_is_made(capsys, in_sequence, in_station, place, words):
    sequence = write("sequence.yaml", SEQUENCE.replace(*in_sequence) if in_sequence else SEQUENCE)
    station = write("station.yaml", PLAIN.replace(*in_station) if in_station else PLAIN)
    status, said = say(capsys, "run", sequence, "--station", station, "--output", "out")
    assert status == 2
    assert place in said
    assert words in said
    assert not Path("out").exists()


def test_a_missing_file_names_what_is_shipped(capsys):
    status, said = say(capsys, "run", "missing", "--station", "simulated")
    assert status == 2
    assert "missing" in said
    assert "three_pose" in said


def test_another_serial_number_on_the_port_is_refused_before_anything_moves(capsys):
    station = write("station.yaml", PLAIN.replace("serial: 100102", "serial: 999999"))
    status, said = say(capsys, "run", "three_pose", "--station", station, "--output", "out")
    assert status == 1
    assert "999999" in said
    assert "100102" in said
    assert '"home' not in Path("out/wire.jsonl").read_text()
    assert " move " not in Path("out/wire.jsonl").read_text()


def test_a_port_in_use_is_refused(capsys, tmp_path):
    import fcntl
    import pty

    _, peer = pty.openpty()
    port = tmp_path / "port"
    port.symlink_to(os.ttyname(peer))
    fcntl.flock(peer, fcntl.LOCK_EX)
    station = write("station.yaml", PLAIN.replace("sim:gimbal", str(port)))
    status, said = say(capsys, "run", "three_pose", "--station", station, "--output", "out")
    assert status == 1
    assert str(port) in said
    assert "another program" in said


@pytest.mark.skipif(not Path("/sys/kernel").is_dir(), reason="needs a folder in which nobody may write")
def test_a_folder_without_permission_is_refused(capsys):
    status, said = say(capsys, "run", "three_pose", "--station", "simulated", "--output", "/sys/kernel/out")
    assert status == 1
    assert "/sys/kernel/out" in said
    assert "permission" in said.lower()


def test_recordings_that_are_none_or_cut_short_are_named(capsys, evk4_recording):
    write("text.raw", "this is no recording")
    whole = evk4_recording.read_bytes()
    Path("half.raw").write_bytes(whole[:-100_001])  # words have two bytes
    for name, words in (("text.raw", "not a"), ("half.raw", "is incomplete")):
        status, said = say(capsys, "calibrate", name)
        assert status == 1
        assert name in said
        assert words in said.lower()


def test_an_image_without_the_target_says_so(capsys):
    import cv2

    cv2.imwrite("noise.png", np.random.default_rng(1).integers(0, 255, (720, 1280), np.uint8))
    status, said = say(capsys, "calibrate", "noise.png")
    assert status == 1
    assert "noise" in said
    assert "tag" in said.lower()


def points(name, stars):
    grid = np.array([(x, y) for y in range(stars) for x in range(stars)], float)
    rows = [f"{600 + 50 * x} {300 + 50 * y} {4 * x} {4 * y} {int(50 * y + x)}" for x, y in grid]
    return write(name, "\n".join(rows))


def test_two_views_that_do_not_constrain_the_camera_are_refused(capsys):
    status, said = say(capsys, "calibrate", points("a.txt", 8), points("b.txt", 8))
    assert status == 1
    assert "pose" in said


def test_a_view_with_too_few_stars_is_refused(capsys):
    status, said = say(capsys, "calibrate", points("a.txt", 1), points("b.txt", 1))
    assert status == 1
    assert "star" in said


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("calibrate", ".", "--views", "0"), "--views"),
        (("verify", "nowhere"), "nowhere"),
        (("resume", "nowhere"), "nowhere"),
        (("run",), "SEQUENCE"),
        (("fly",), "fly"),
    ],
)
def test_wrong_words_are_answered(capsys, words, message):
    write("home_made", "")
    status, said = say(capsys, *words)
    assert status in {1, 2}
    assert message in said


def test_a_changed_sequence_is_not_resumed(capsys):
    station = write("station.yaml", PLAIN.replace("serial: SG0042", "serial: SG9999"))
    assert say(capsys, "run", "three_pose", "--station", station, "--output", "out")[0] == 1
    shutil.copy("out/sequence.yaml", "keep")
    Path("out/sequence.yaml").write_text(SEQUENCE.replace("window_ms: 33", "window_ms: 50"))
    status, said = say(capsys, "resume", "out")
    assert status == 1
    assert "was changed after this run began" in said
