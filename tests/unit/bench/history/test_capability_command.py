"""`starbench runs --capability`, as a user calls it."""

import json
from datetime import timedelta

import numpy as np
import pytest
from many_runs import BEGIN, VALUES, BenchOfRuns

from bench.commands.cli import main

LIMITS = [{"result": "fx", "lower": 3300.0, "upper": 3390.0}, {"result": "cx", "lower": None, "upper": 700.0}]


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("STARBENCH_HOME", str(tmp_path / "here"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "here"


def call(capsys, *words):
    with pytest.raises(SystemExit) as ended:
        main(["runs", "--capability", *map(str, words)])
    told = capsys.readouterr()
    return ended.value.code or 0, told.out, told.err


def benches(folder, operators=("ada", "bob"), cameras=5, repeats=2, days=2, **facts):
    """Two benches; cameras differ by 10 px, operators by 1 px, repeats by 0.5 px."""
    rng = np.random.default_rng(5)
    true = rng.normal(0, 10, cameras)
    homes = []
    for name in ("a", "b"):
        made, hour = BenchOfRuns(folder / name / "home", folder / name / "runs", station=f"Bench {name}"), 0
        for camera in range(cameras):
            for at, operator in enumerate(operators):
                for repeat in range(repeats):
                    hour += 1
                    fx = 3345.0 + true[camera] + at + rng.normal(0, 0.5)
                    begun = BEGIN + timedelta(days=repeat % days, minutes=hour)
                    values = {
                        **VALUES,
                        **{n: VALUES[n] + rng.normal(0, 0.1) for n in ("fy", "cx", "cy", "k1", "k2")},
                    }
                    told = {"serial": f"0005000{camera}", "operator": operator, "limits": LIMITS, **facts}
                    made.run(begun=begun, values={**values, "fx": fx}, **told)
        homes.append(made.close())
    return [word for home in homes for word in ("--ledger", home)]


def test_the_study_tells_the_share_of_the_bench_and_the_capability(tmp_path, capsys, home):
    ledgers = benches(tmp_path)
    status, out, err = call(capsys, *ledgers)
    assert (status, err) == (0, "")
    lines = out.splitlines()
    assert lines[0] == "40 runs, 5 cameras, 2 operators; standard deviations:"
    assert lines[2].startswith("fx  px")
    assert lines[2].endswith("good")
    assert not any(line.startswith("r ") for line in lines)  # the collimator is no camera
    _, out, _ = call(capsys, "operator,bench,day", *ledgers, "--json")
    fx = next(one for one in json.loads(out)["parameters"] if one["name"] == "fx")
    assert set(json.loads(out)["factors"]) == {"operator", "bench", "day"}
    assert fx["repeatability"] == pytest.approx(0.5, rel=0.4)
    assert fx["components"]["operator"] == pytest.approx(np.sqrt(0.5), rel=0.4)
    assert fx["components"]["camera"] == pytest.approx(10, rel=0.6)
    assert fx["gauge_percent"] < 20
    assert fx["cp"] == pytest.approx(90 / 6 / fx["total"])
    assert fx["tolerance_percent"] == pytest.approx(100 * 6 * fx["gauge"] / 90)
    cx = next(one for one in json.loads(out)["parameters"] if one["name"] == "cx")
    assert (cx["cp"], cx["tolerance_percent"]) == (None, None)
    assert cx["verdict"] == "not good"


@pytest.mark.parametrize(
    ("words", "facts", "message"),
    [
        ((), {"operators": ("ada",)}, "A gauge study needs at least 2 operators; these runs have 1: ada."),
        ((), {"operators": ("ada", None)}, "20 of 40 runs name no operator."),
        ((), {"cameras": 1}, "A gauge study needs at least 2 cameras; these runs have 1: 00050000."),
        (("day",), {"days": 1}, "A gauge study needs at least 2 days; these runs have 1: 2026-01-05."),
        (("operator,moon",), {}, "There is no factor 'moon'."),
        ((), {"ended": "failed"}, "There is no finished run with a result."),
        (("operator", "--chart"), {}, "--capability cannot be used with --compare, --chart or --output."),
    ],
)
def test_what_a_study_cannot_use_is_one_clear_error(tmp_path, capsys, home, words, facts, message):
    status, out, err = call(capsys, *words, *benches(tmp_path, **facts))
    assert (status, out) == (2, "")
    assert message in err
    assert len(err.strip().splitlines()) == 1


def test_measured_and_simulated_runs_are_never_mixed(tmp_path, capsys, home):
    ledgers = [*benches(tmp_path / "one"), *benches(tmp_path / "two", simulated=True)]
    status, _, err = call(capsys, *ledgers)
    assert status == 2
    assert "The runs are of 2 kinds, which a study never mixes: measured / " in err
