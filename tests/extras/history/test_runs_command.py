"""`starbench runs` with --ledger and `starbench history`, as a user calls them."""

import json
from datetime import timedelta

import pytest
from calling import ended
from many_runs import BEGIN, VALUES, BenchOfRuns, write_run

CHARTS, TABLE = (("history", what) for what in ("charts", "table"))


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "here"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "here"


def bench(folder, count=8, **facts):
    made = BenchOfRuns(folder / "home", folder / "runs")
    for n in range(count):
        values = {**VALUES, "fx": 3345.0 + (-1) ** n * 0.1 * (n % 3) + facts.get("step", 0.0) * n}
        made.run(begun=BEGIN + timedelta(hours=n), values=values, temperature_c=40.0 + n % 3)
    return made.close()


def test_the_runs_of_two_benches_are_listed_and_exported(tmp_path, capsys, home):
    homes = [bench(tmp_path / "a", 2), bench(tmp_path / "b", 3)]
    ledgers = [word for home in homes for word in ("--ledger", home)]
    status, (out, err) = ended(capsys, "runs", *ledgers)
    assert (status, len(out.splitlines()), err) == (0, 6, "")
    status, (out, _) = ended(capsys, *TABLE, *ledgers, "--output", "runs.csv", "--serial", "00050001")
    assert (status, out[:16]) == (0, "runs.csv: 5 runs")
    assert (tmp_path / "runs.csv").read_text().count("starbench/runs-table/1") == 5


def test_the_runs_of_a_folder_are_compared(tmp_path, capsys, home):
    bench(tmp_path / "a", 2)
    status, (out, _) = ended(capsys, "history", "agreement", tmp_path / "a" / "runs")
    assert (status, "2 runs of camera 00050001" in out, "Birge ratio" in out) == (0, True, True)


def test_a_fault_is_printed_and_the_table_is_written_all_the_same(tmp_path, capsys, home):
    ledger = bench(tmp_path / "a", 2)
    (tmp_path / "a" / "runs" / "run-00002").rename(tmp_path / "elsewhere")
    status, (out, err) = ended(capsys, *TABLE, "--ledger", ledger, "--output", "runs.csv")
    assert (status, out.split(":")[1]) == (1, " 1 run, schema starbench/runs-table/1.\n")
    assert err.startswith("FAULT: run 2 of home")
    status, (out, _) = ended(capsys, *TABLE, "--ledger", ledger, "--output", "again.csv", "--json")
    assert (status, json.loads(out)["rows"], len(json.loads(out)["faults"])) == (1, 1, 1)


def test_the_charts_and_their_verdict(tmp_path, capsys, home):
    steady, drifting = bench(tmp_path / "a"), bench(tmp_path / "b", 30, step=0.5)
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", steady)
    assert status == 0
    assert "In control." in out
    assert out.endswith("Charts: runs-charts.html\n")
    assert (tmp_path / "runs-charts.html").read_text().startswith("<!DOCTYPE html>")
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", drifting, "--output", "drifting.html")
    assert status == 1
    assert "+0.4993 ± 0.0059 px per hour" in out
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", drifting, "--baseline", "20", "--json")
    (group,) = json.loads(out)["groups"]
    assert group["parameters"][0]["baseline"] == 20
    assert group["parameters"][0]["drift"]["per_day"]["seen"]


def test_a_single_run_is_too_few(tmp_path, capsys, home):
    write_run(tmp_path / "runs" / "one")
    status, (out, _) = ended(capsys, *CHARTS, "runs")
    assert status == 0
    assert "too few" in out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ([*CHARTS, "empty"], "There is no run with a result."),
        ([*CHARTS, "runs", "--output", "x.pdf"], "a name that ends in .html"),
        ([*CHARTS, "runs", "--output", "none/x.html"], "The folder of this file does not exist."),
        ([*TABLE, "runs", "--baseline", "9"], "`history charts` has it."),
        (["history", "agreement", "runs", "-o", "x.csv"], "`history agreement` writes no file."),
        ([*TABLE, "--ledger", "empty", "--output", "x.csv"], "There is no ledger in this folder."),
        ([*TABLE, "runs"], "The file is missing."),
    ],
)
def test_what_cannot_be_done_is_said_with_what_to_do(tmp_path, capsys, home, words, what):
    write_run(tmp_path / "runs" / "one")
    (tmp_path / "empty").mkdir()
    status, (_, err) = ended(capsys, *words)
    assert status == 2
    assert what in err
