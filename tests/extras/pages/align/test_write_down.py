"""Writing into station and sequence files: only what changed changes, comments stay, and nothing is written unseen."""

import shutil
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


def test_an_axis_outside_its_limits_cannot_become_zero(station):
    with pytest.raises(ControlRefused, match="outside its limits"):
        station_values(load_station(str(station)).value, position_deg={"pan": 13.0})


def test_the_light_goes_into_the_defaults_of_the_sequence(tmp_path):
    path = tmp_path / "nine.yaml"
    shutil.copy(SEQUENCES / "three_pose.yaml", path)
    light = {"waveform": "square", "frequency_hz": "80", "level_percent": "40"}
    changed = _changed(propose_pose(path, {"pan": 1.0}, light=light))
    assert "+    - {pan_deg: 1}" in changed
    assert any(line.startswith("+  light:") and "frequency_hz: 80" in line for line in changed)
    assert any("level_percent: 40" in line for line in changed)
