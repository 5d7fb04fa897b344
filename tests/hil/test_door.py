"""A door that is opened while a run moves and records: seen from outside."""

import json

import pytest
from quick_runs import THREE_NAMED, write_sequence, write_station
from running import PATIENCE_S, entering, journal, numbers, starbench, start, wait_for


@pytest.mark.slow
def test_a_door_holds_the_run_dark_within_a_moment_and_it_ends_with_the_same_numbers(tmp_path):
    home, door, folder = tmp_path / "home", tmp_path / "door", tmp_path / "run"
    door.write_text("1\n")
    station = write_station(tmp_path / "station.yaml", f"\ninterlocks: {{door: {{path: {door}}}}}\n")
    sequence = write_sequence(tmp_path / "sequence.yaml", THREE_NAMED)
    whole = starbench("run", sequence, "-s", station, "--seed", 7, "-o", tmp_path / "whole", home=home)
    assert whole.returncode == 0, whole.stderr
    process = start("run", sequence, "-s", station, "--seed", 7, "-o", folder, home=home)
    try:
        wait_for(process, folder, entering("settling", None))
        wait_for(process, folder, entering("slewing", 2))
        door.write_text("0\n")
        wait_for(process, folder, entering("holding"))
        status = json.loads(starbench("status", folder, "--json", home=home).stdout)
        assert status["held_by"].startswith("the door interlock: it is open")
        sent = [json.loads(line) for line in (folder / "wire.jsonl").read_text().splitlines()]
        switched = [line["bytes"] for line in sent if line["dir"] == ">" and "OUTP" in line["bytes"]]
        assert "OUTP 0" in "".join(switched[-3:]) or "OUTP OFF" in "".join(switched[-3:]), switched[-3:]
        door.write_text("1\n")
        said = process.communicate(timeout=PATIENCE_S)[1]
    finally:
        process.kill()
        process.communicate()
    assert process.returncode == 0, said
    (released,) = [line for line in journal(folder) if line["event"] == "interlock_released"]
    assert released["rule"] == "door"
    told = numbers(folder)
    assert told["stars"] == numbers(tmp_path / "whole")["stars"]
    assert told["calibration"] == numbers(tmp_path / "whole")["calibration"]
    assert starbench("verify", folder, home=home).returncode == 0
