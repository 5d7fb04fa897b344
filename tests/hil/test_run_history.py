"""Every run of a bench is in its ledger, however it ended; runs are listed and compared."""

import json

import pytest
from running import end_when, entering, journal, results, starbench, start

from bench.records.journal import read_journal
from bench.records.ledger import Ledger

SEED = 7
CLOCKS = {"utc_now": lambda: None, "monotonic": lambda: 0.0}


def listed(home, *words):
    said = starbench("runs", *words, "--json", home=home)
    return said.returncode, json.loads(said.stdout)


@pytest.mark.slow
def test_every_run_is_entered_listed_and_compared(tmp_path):
    home, killed, whole = tmp_path / "home", tmp_path / "runs" / "killed", tmp_path / "runs" / "whole"
    process = start("run", "three_pose", "-s", "simulated", "--seed", SEED, "-o", killed, home=home)
    end_when(process, killed, entering("slewing", 1))
    assert [run.how for run in Ledger(home, **CLOCKS).runs()] == ["open"]
    said = starbench("run", "three_pose", "-s", "simulated", "--seed", SEED + 1, "-o", whole, home=home)
    assert said.returncode == 0, said.stderr
    assert results(whole)["run"]["ledger"]["number"] == 2
    assert results(whole)["run"]["ledger"]["of_camera"] == {"open": 2}
    assert (
        "2 of this bench; earlier runs of this camera: 1 without an end"
        in (whole / "report.html").read_text()
    )
    assert starbench("resume", killed, home=home).returncode == 0
    first, second = Ledger(home, **CLOCKS).runs()
    assert (first.how, second.how) == ("finished", "finished")
    assert first.seal is not None
    assert first.seal != second.seal
    # Neither was calibrated when the other one began.
    assert [results(run)["previous"]["run"] for run in (killed, whole)] == [None, None]
    assert journal(killed)[0]["ledger"]["head"] == read_journal(home / "ledger.jsonl")[0][0].hash

    status, told = listed(home)
    assert status == 0
    assert [run["id"] for run in told["runs"]] == ["killed", "whole"]
    assert told["runs"][1]["parameters"]["fx"]["value"] == results(whole)["calibration"]["camera"]["fx"]
    compared = starbench("runs", tmp_path / "runs", "--compare", home=home)
    assert "2 runs of camera 00050423" in compared.stdout
    assert "Birge ratio" in compared.stdout
    assert listed(home, "--serial", "other") == (0, {"schema": "starbench/runs/1", "runs": [], "faults": []})

    whole.rename(tmp_path / "hidden")
    status, told = listed(home)
    assert status == 1
    assert "run 2 (whole): its folder " in told["faults"][0]
