"""Writing into station and sequence files: only what changed changes, comments stay, and nothing is written unseen."""

import shutil
import stat
from pathlib import Path

import pytest
from filled_stations import filled_example

from bench.base.errors import ControlRefused, ScriptError
from bench.extras.pages.align.write_down import must_be_copied, propose_pose, propose_values, station_values
from bench.stations.station import SHIPPED_STATIONS, Station, load_station
from sequences.reader import read_document
from sequences.schema import Sequence

SEQUENCES = Path(SHIPPED_STATIONS).parents[1] / "sequences"


@pytest.fixture
def station(tmp_path):
    path = tmp_path / "bench.yaml"
    path.write_text(filled_example("example_evk4"), encoding="utf-8")
    return path


def _changed(proposal):
    lines = proposal.difference.splitlines()[2:]
    return [line for line in lines if line[0] in "+-"]


def test_zero_biases_and_light_change_only_their_own_lines(station):
    before = load_station(str(station)).value
    values, notes = station_values(
        before,
        position_deg={"pan": 1.23456, "tilt": 0.0},
        biases={"bias_diff_on": 20, "bias_diff_off": 0, "bias_fo": -5},
        level_percent=60,
    )
    proposal = propose_values(station, values, Station)
    assert _changed(proposal) == [
        "-      zero_deg: 0                 # angle of the bench at which the controller's counter is 0",
        "-      limits_deg: [-12, 12]",
        "+      zero_deg: -1.2346           # angle of the bench at which the controller's counter is 0",
        "+      limits_deg: [-13.2346, 10.7654]",
        "-  high_v: 2.5      # voltage at which the lamp has full brightness; a higher one may destroy the lamp",
        "+  high_v: 1.5      # voltage at which the lamp has full brightness; a higher one may destroy the lamp",
        "-  biases: {bias_diff_on: 0, bias_diff_off: 0}",
        "+  biases: {bias_diff_on: 20, bias_diff_off: 0, bias_fo: -5}",
    ]
    assert any("limits move" in note for note in notes)
    proposal.write(proposal.mark)
    after = load_station(str(station)).value
    assert after.axes["pan"].zero_deg == pytest.approx(-1.2346)
    assert after.camera.serial == "00051234"
    assert after.camera.biases.bias_fo == -5


def test_a_copy_of_a_practice_bench_keeps_what_the_hands_have_set(tmp_path):
    source = SHIPPED_STATIONS / "simulated_unaligned.yaml"
    seen = {"focus_distance_m": 3.86123, "f_number": 2.8, "turn_deg": [0.0, 0.0, 10.0], "ring_deg": 8.9}
    values, notes = station_values(load_station(str(source)).value, hands=seen)
    assert any("Lens and mount" in note for note in notes)
    proposal = propose_values(source, values, Station, target=tmp_path / "mine.yaml")
    proposal.write(proposal.mark)
    simulation = load_station(str(tmp_path / "mine.yaml")).value.simulation
    assert float(simulation["lens"]["focus_distance_m"]) == pytest.approx(3.86123)
    assert [float(angle) for angle in simulation["mount"]["turn_deg"]] == [0.0, 0.0, 10.0]
    infinity, _ = station_values(
        load_station(str(source)).value, hands={**seen, "focus_distance_m": "infinity"}
    )
    assert infinity["simulation", "lens", "focus_distance_m"] == "infinity"


def test_writing_twice_from_one_pose_changes_nothing_more(station):
    before = load_station(str(station)).value  # the devices were opened with this
    values, _ = station_values(before, position_deg={"pan": 2.0})
    first = propose_values(station, values, Station)
    first.write(first.mark)
    assert propose_values(station, values, Station).difference == ""


def test_a_file_without_the_keys_gets_them_inside_their_sections(tmp_path):
    path = tmp_path / "bench.yaml"
    shutil.copy(SHIPPED_STATIONS / "simulated.yaml", path)
    values, _ = station_values(
        load_station(str(path)).value, position_deg={"tilt": 0.5}, biases={"bias_fo": 3}, level_percent=100
    )
    proposal = propose_values(path, values, Station)
    assert sorted(_changed(proposal)) == [
        "+      limits_deg: [-10.5, 9.5]",
        "+      zero_deg: -0.5",
        "+  biases: {bias_fo: 3}",
        "-      limits_deg: [-10, 10]",
    ]
    proposal.write(proposal.mark)
    assert load_station(str(path)).value.camera.biases.bias_fo == 3


@pytest.mark.parametrize("name", sorted(path.name for path in SEQUENCES.glob("*.yaml")))
def test_a_pose_is_added_to_every_shipped_sequence_without_changing_another_line(tmp_path, name):
    path = tmp_path / name
    shutil.copy(SEQUENCES / name, path)
    proposal = propose_pose(path, {"pan": 1.25, "tilt": -3.0}, name="centre")
    changed = _changed(proposal)
    assert not [line for line in changed if line.startswith("-")]
    assert "{name: centre, pan_deg: 1.25, tilt_deg: -3}" in changed[-1]
    proposal.write(proposal.mark)
    read_document(path, Sequence)


def test_a_grid_takes_no_single_pose(tmp_path):
    path = tmp_path / "nine.yaml"
    shutil.copy(SEQUENCES / "nine_pose.yaml", path)
    with pytest.raises(ControlRefused, match="are a grid"):
        propose_pose(path, {"pan": 1.0}, poses="nine")
    assert "No step of this sequence uses" in propose_pose(path, {"pan": 1.0}).notes[0]


def test_all_text_keeps_its_form(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_text(
        '# first\nformat: starbench/sequence/1\nname: "a: b"   # name\ndescription: >-\n    Ä long\n    text\n\n'
        "poses:\n    list:   # the list\n        - {pan_deg: 1.0e-1}  # one\n\n        - pan_deg: 7.00\n"
        "\n# before the steps\nsteps: [light, report]   # all\n# end\n"
    )
    proposal = propose_pose(path, {"pan": 2.0})
    assert _changed(proposal) == ["+        - {pan_deg: 2}"]


def test_a_file_that_changed_since_it_was_shown_is_not_written(station):
    values, _ = station_values(load_station(str(station)).value, level_percent=50)
    shown = propose_values(station, values, Station)
    station.write_text(station.read_text() + "# a note of somebody else\n")
    again = propose_values(station, values, Station)
    with pytest.raises(ControlRefused, match="changed since the difference was shown"):
        again.write(shown.mark)
    assert "somebody else" in station.read_text()
    assert "high_v: 2.5" in station.read_text()


def test_values_that_the_reader_refuses_are_not_written(station):
    before = station.read_bytes()
    with pytest.raises(ScriptError, match="bias_fo"):
        propose_values(station, {("camera", "biases", "bias_fo"): "9999"}, Station)
    assert station.read_bytes() == before


def test_a_shipped_file_is_only_copied(tmp_path):
    source = SHIPPED_STATIONS / "simulated.yaml"
    before = source.read_bytes()
    assert "came with Starbench" in must_be_copied(source)
    values = {("light", "high_v"): "4"}
    with pytest.raises(ControlRefused, match="came with Starbench") as error:
        propose_values(source, values, Station)
    assert error.value.remedy == "Give a name for a copy."
    copy = propose_values(source, values, Station, target=tmp_path / "mine.yaml")
    assert copy.is_copy
    copy.write(copy.mark)
    assert load_station(str(tmp_path / "mine.yaml")).value.light.high_v == 4
    assert source.read_bytes() == before
    with pytest.raises(ControlRefused, match="A file of this name exists"):
        copy.write(copy.mark)


def test_the_mode_of_a_file_stays(station):
    station.chmod(0o640)
    values = {("light", "high_v"): "2"}
    proposal = propose_values(station, values, Station)
    proposal.write(proposal.mark)
    assert stat.S_IMODE(station.stat().st_mode) == 0o640
    assert [path.name for path in station.parent.iterdir()] == ["bench.yaml"]


def test_an_axis_outside_its_limits_cannot_become_zero(station):
    with pytest.raises(ControlRefused, match="outside its limits"):
        station_values(load_station(str(station)).value, position_deg={"pan": 13.0})


def test_exposure_and_gain_of_a_frame_camera_are_written(tmp_path):
    path = tmp_path / "bench.yaml"
    shutil.copy(SHIPPED_STATIONS / "simulated_frames.yaml", path)
    values, _ = station_values(load_station(str(path)).value, frame={"exposure": -6.5, "gain": None})
    assert _changed(propose_values(path, values, Station)) == ["+  exposure: -6.5"]


def test_the_light_goes_into_the_defaults_of_the_sequence(tmp_path):
    path = tmp_path / "nine.yaml"
    shutil.copy(SEQUENCES / "three_pose.yaml", path)
    light = {"waveform": "square", "frequency_hz": "80", "level_percent": "40"}
    changed = _changed(propose_pose(path, {"pan": 1.0}, light=light))
    assert "+    - {pan_deg: 1}" in changed
    assert any(line.startswith("+  light:") and "frequency_hz: 80" in line for line in changed)
    assert any("level_percent: 40" in line for line in changed)
