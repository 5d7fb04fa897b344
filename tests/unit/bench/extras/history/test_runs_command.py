"""`starbench runs` with --ledger and `starbench history`, as a user calls them."""

import json
from datetime import timedelta
from itertools import product

import numpy as np
import pytest
from calling import ended
from many_runs import BEGIN, VALUES, BenchOfRuns, write_run

CHARTS, CAPABILITY, TABLE = (("history", what) for what in ("charts", "capability", "table"))


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
    assert (status, out) == (0, "runs.csv: 5 runs, schema starbench/runs-table/1.\n")
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
    assert err.startswith("FAULT: run 2 of home (run-00002, finished): its folder ")
    status, (out, _) = ended(capsys, *TABLE, "--ledger", ledger, "--output", "runs.csv", "--json")
    assert (status, json.loads(out)["rows"], len(json.loads(out)["faults"])) == (1, 1, 1)


def test_the_charts_and_their_verdict(tmp_path, capsys, home):
    steady, drifting = bench(tmp_path / "a"), bench(tmp_path / "b", 30, step=0.5)
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", steady)
    assert status == 0
    assert "In control. No significant drift." in out
    assert out.endswith("Charts: runs-charts.html\n")
    assert (tmp_path / "runs-charts.html").read_text().startswith("<!DOCTYPE html>")
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", drifting, "--output", "drifting.html")
    assert status == 1
    assert "It drifts with time: +0.4993 ± 0.0059 px per hour" in out
    status, (out, _) = ended(capsys, *CHARTS, "--ledger", drifting, "--baseline", "20", "--json")
    (group,) = json.loads(out)["groups"]
    assert group["parameters"][0]["baseline"] == 20
    assert group["parameters"][0]["drift"]["per_day"]["seen"]


def test_a_single_run_is_too_few(tmp_path, capsys, home):
    write_run(tmp_path / "runs" / "one")
    status, (out, _) = ended(capsys, *CHARTS, "runs")
    assert status == 0
    assert "1 run: too few for a verdict" in out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        ([*CHARTS, "empty"], "There is no run with a result."),
        ([*CHARTS, "runs", "--output", "x.pdf"], "The page is an HTML file."),
        ([*CHARTS, "runs", "--output", "none/x.html"], "The folder of this file does not exist."),
        (
            [*CHARTS, "runs", "--factors", "day"],
            "`history charts` has no --factors. Leave it out; `history capability` has it.",
        ),
        (["history", "agreement", "runs", "-o", "x.csv"], "`history agreement` writes no file."),
        ([*TABLE, "--ledger", "empty", "--output", "x.csv"], "There is no ledger in this folder."),
        ([*TABLE, "runs", "--output", "x.json"], "not as .json"),
        ([*TABLE, "runs"], "The file is missing."),
    ],
)
def test_what_cannot_be_done_is_said_with_what_to_do(tmp_path, capsys, home, words, what):
    write_run(tmp_path / "runs" / "one")
    (tmp_path / "empty").mkdir()
    status, (_, err) = ended(capsys, *words)
    assert status == 2
    assert what in err


# ---------------------------------------------------------------- capability

LIMITS = [{"result": "fx", "lower": 3300.0, "upper": 3390.0}, {"result": "cx", "lower": None, "upper": 700.0}]


def benches(folder, operators=("ada", "bob"), cameras=5, repeats=2, days=2, **facts):
    """Two benches; cameras differ by 10 px, operators by 1 px, repeats by 0.5 px."""
    rng = np.random.default_rng(5)
    true = rng.normal(0, 10, cameras)
    homes = []
    for name in ("a", "b"):
        made = BenchOfRuns(folder / name / "home", folder / name / "runs", station=f"Bench {name}")
        shots = product(range(cameras), enumerate(operators), range(repeats))
        for minute, (camera, (at, operator), repeat) in enumerate(shots, 1):
            fx = 3345.0 + true[camera] + at + rng.normal(0, 0.5)
            others = {n: VALUES[n] + rng.normal(0, 0.1) for n in ("fy", "cx", "cy", "k1", "k2")}
            begun = BEGIN + timedelta(days=repeat % days, minutes=minute)
            facts_of_run = {"serial": f"0005000{camera}", "operator": operator, "limits": LIMITS, **facts}
            made.run(begun=begun, values={**VALUES, **others, "fx": fx}, **facts_of_run)
        homes.append(made.close())
    return [word for home in homes for word in ("--ledger", home)]


def test_the_study_tells_the_share_of_the_bench_and_the_capability(tmp_path, capsys, home):
    ledgers = benches(tmp_path)
    status, (out, err) = ended(capsys, *CAPABILITY, *ledgers)
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "40 runs, 5 cameras, 2 operators; standard deviations:"
    assert lines[2].startswith("fx  px")
    assert lines[2].endswith("good")
    assert not any(line.startswith("r ") for line in lines)  # the collimator is no camera
    _, (out, _) = ended(capsys, *CAPABILITY, "--factors", "operator,bench,day", *ledgers, "--json")
    fx = next(parameter for parameter in json.loads(out)["parameters"] if parameter["name"] == "fx")
    assert set(json.loads(out)["factors"]) == {"operator", "bench", "day"}
    assert fx["repeatability"] == pytest.approx(0.5, rel=0.4)
    assert fx["components"]["operator"] == pytest.approx(np.sqrt(0.5), rel=0.4)
    assert fx["components"]["camera"] == pytest.approx(10, rel=0.6)
    assert fx["gauge_percent"] < 20
    assert fx["cp"] == pytest.approx(90 / 6 / fx["total"])
    assert fx["tolerance_percent"] == pytest.approx(100 * 6 * fx["gauge"] / 90)
    cx = next(parameter for parameter in json.loads(out)["parameters"] if parameter["name"] == "cx")
    assert (cx["cp"], cx["tolerance_percent"]) == (None, None)
    assert cx["verdict"] == "not good"


@pytest.mark.parametrize(
    ("words", "facts", "message"),
    [
        ((), {"operators": ("ada",)}, "A gauge study needs at least 2 operators; these runs have 1: ada."),
        ((), {"operators": ("ada", None)}, "20 of 40 runs name no operator."),
        ((), {"cameras": 1}, "A gauge study needs at least 2 cameras; these runs have 1: 00050000."),
        (
            ("--factors", "day"),
            {"days": 1},
            "A gauge study needs at least 2 days; these runs have 1: 2026-01-05.",
        ),
        (("--factors", "operator,moon"), {}, "There is no factor 'moon'."),
        ((), {"ended": "failed"}, "There is no finished run with a result."),
    ],
)
def test_what_a_study_cannot_use_is_one_clear_error(tmp_path, capsys, home, words, facts, message):
    status, (out, err) = ended(capsys, *CAPABILITY, *words, *benches(tmp_path, **facts))
    assert (status, out) == (2, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_measured_and_simulated_runs_are_never_mixed(tmp_path, capsys, home):
    ledgers = [*benches(tmp_path / "one"), *benches(tmp_path / "two", simulated=True)]
    status, (_, err) = ended(capsys, *CAPABILITY, *ledgers)
    assert status == 2
    assert "The runs are of 2 kinds, which a study never mixes: measured / " in err
