"""`starbench runs` with --ledger, --output and --chart, as a user calls it."""

import json
from datetime import timedelta

import pytest
from many_runs import BEGIN, VALUES, BenchOfRuns, write_run

from bench.commands.cli import main


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "here"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "here"


def call(capsys, *words):
    """Exit status, what was printed, and what was said beside it."""
    with pytest.raises(SystemExit) as ended:
        main(["runs", *map(str, words)])
    told = capsys.readouterr()
    return ended.value.code or 0, told.out, told.err


def bench(folder, count=8, **facts):
    made = BenchOfRuns(folder / "home", folder / "runs")
    for n in range(count):
        values = {**VALUES, "fx": 3345.0 + (-1) ** n * 0.1 * (n % 3) + facts.get("step", 0.0) * n}
        made.run(begun=BEGIN + timedelta(hours=n), values=values, temperature_c=40.0 + n % 3)
    return made.close()


def test_the_runs_of_two_benches_are_listed_and_exported(tmp_path, capsys, home):
    homes = [bench(tmp_path / "a", 2), bench(tmp_path / "b", 3)]
    ledgers = [word for one in homes for word in ("--ledger", one)]
    status, out, err = call(capsys, *ledgers)
    assert (status, len(out.splitlines()), err) == (0, 6, "")
    status, out, _ = call(capsys, *ledgers, "--output", "runs.csv", "--serial", "00050001")
    assert (status, out) == (0, "runs.csv: 5 runs, schema starbench/runs-table/1.\n")
    assert (tmp_path / "runs.csv").read_text().count("starbench/runs-table/1") == 5


def test_a_fault_is_printed_and_the_table_is_written_all_the_same(tmp_path, capsys, home):
    ledger = bench(tmp_path / "a", 2)
    (tmp_path / "a" / "runs" / "run-00002").rename(tmp_path / "elsewhere")
    status, out, err = call(capsys, "--ledger", ledger, "--output", "runs.csv")
    assert (status, out.split(":")[1]) == (1, " 1 run, schema starbench/runs-table/1.\n")
    assert err.startswith("FAULT: run 2 of home (run-00002, finished): its folder ")
    status, out, _ = call(capsys, "--ledger", ledger, "--output", "runs.csv", "--json")
    assert (status, json.loads(out)["rows"], len(json.loads(out)["faults"])) == (1, 1, 1)


def test_the_charts_and_their_verdict(tmp_path, capsys, home):
    steady, drifting = bench(tmp_path / "a"), bench(tmp_path / "b", 30, step=0.5)
    status, out, _ = call(capsys, "--ledger", steady, "--chart")
    assert status == 0
    assert "In control. No significant drift." in out
    assert out.endswith("Charts: runs-charts.html\n")
    assert (tmp_path / "runs-charts.html").read_text().startswith("<!DOCTYPE html>")
    status, out, _ = call(
        capsys, "--ledger", drifting, "--chart", "fx", "--output", "fx.html", "--by", "camera"
    )
    assert status == 1
    assert "It drifts with time: +0.4993 ± 0.0059 px per hour" in out
    status, out, _ = call(capsys, "--ledger", drifting, "--chart", "fx", "--baseline", "20", "--json")
    (group,) = json.loads(out)["groups"]
    assert group["parameters"][0]["baseline"] == 20
    assert group["parameters"][0]["drift"]["per_day"]["seen"]


def test_a_folder_after_the_option_is_a_folder(tmp_path, capsys, home):
    write_run(tmp_path / "runs" / "one")
    status, out, _ = call(capsys, "--chart", "runs")
    assert status == 0
    assert "1 run: too few for a verdict" in out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["runs", "--chart", "focal"], "No run has a parameter 'focal'. There are: fx, fy,"),
        (["empty", "--chart"], "There is no run with a result."),
        (["runs", "--chart", "--output", "x.pdf"], "The page is an HTML file."),
        (["runs", "--chart", "--output", "none/x.html"], "The folder of this file does not exist."),
        (["runs", "--chart", "fx", "--compare"], "cannot be used with"),
        (["--ledger", "empty", "--output", "x.csv"], "There is no ledger in this folder."),
        (["runs", "--output", "x.json"], "not as .json"),
    ],
)
def test_what_cannot_be_done_is_said_with_what_to_do(tmp_path, capsys, home, words, what):
    write_run(tmp_path / "runs" / "one")
    (tmp_path / "empty").mkdir()
    status, _, err = call(capsys, *words)
    assert status == 2
    assert what in err


def test_simulated_and_measured_runs_of_one_camera_are_in_two_charts(tmp_path, capsys, home):
    for n in range(6):
        write_run(tmp_path / "runs" / f"s{n}", begun=BEGIN + timedelta(hours=n), simulated=True)
        write_run(tmp_path / "runs" / f"m{n}", begun=BEGIN + timedelta(hours=n), temperature_c=None)
    status, out, _ = call(capsys, "runs", "--chart", "fx")
    assert status == 0
    assert out.count("Camera 00050001, Prophesee EVK4: 6 runs") == 2
    assert out.count("SIMULATED: Camera") == 1
