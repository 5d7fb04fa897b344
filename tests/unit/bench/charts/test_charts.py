"""Charts: which runs are in one, what the verdict says, and the page."""

import math
import re
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from bench.charts.chart_findings import find_charts
from bench.charts.chart_groups import ChartGroup, ChartKey, ChartRun, group_runs
from bench.record.coverage import Estimate
from bench.record.run_facts import IndexedRun, RunPlace
from bench.report.control_chart import render_charts
from tests.unit.bench.report.structure import Structure

BEGUN = datetime(2026, 1, 5, tzinfo=UTC)
DETAILS = {"camera_type": "Prophesee EVK4", "collimator_serial": "C-1", "target_serial": "T-1"}
PLACE = RunPlace("bench@lab", "abc", "entered")


def run(n, *, fx=3345.0, sigma=1.0, **facts):
    defaults = {
        "folder": f"/runs/{n}", "id": f"run-{n}", "sequence": "Three", "station": "Bench 1", "camera": "1", "operator": None,
        "simulated": False, "rehearsal": False, "begun_utc": (BEGUN + timedelta(hours=n)).isoformat(), "how": "finished",
        "sealed": True, "accepted": 3, "recordings": 3, "deviations": 0, "temperature_c": 40.0, "model": "radial",
        "rms_px": 0.1, "parameters": {"fx": Estimate(fx, sigma, 2.2)}, "coverage_factor": 2.2,
    }  # fmt: skip
    return IndexedRun(**{**defaults, **facts})


def indexed(*runs, details=DETAILS, place=PLACE):
    return [(run, details, place) for run in runs]


def steady(count, rng, parameters=("fx",), shift=lambda n, name: 0.0, warm=True):
    """A group of runs in control, but for ``shift``."""
    key = ChartKey("camera", "measured", "b", "s", "EVK4", "1", "c", "t", "radial", tuple(parameters))
    runs = [
        ChartRun(
            f"run-{n}", f"/{n}", "1", BEGUN + timedelta(hours=n), 40.0 + rng.normal(0, 0.5) if warm else None,
            {name: Estimate(3345.0 + rng.normal() + shift(n, name), 1.0) for name in parameters},
        )
        for n in range(count)
    ]  # fmt: skip
    return ChartGroup(key, runs)


def chart_of(page, name="fx"):
    return next(chart for chart in page["groups"][0]["parameters"] if chart["name"] == name)


@pytest.mark.parametrize(
    ("other", "details", "place"),
    [
        (run(1, simulated=True), DETAILS, PLACE),
        (run(1, rehearsal=True), DETAILS, PLACE),
        (run(1, model="planar"), DETAILS, PLACE),
        (run(1, station="Bench 2"), DETAILS, PLACE),
        (run(1, parameters={"fx": Estimate(1.0, 1.0), "k1": Estimate(1.0, 1.0)}), DETAILS, PLACE),
        (run(1), {**DETAILS, "target_serial": "T-2"}, PLACE),
        (run(1), {**DETAILS, "collimator_serial": "C-2"}, PLACE),
        (run(1), {**DETAILS, "camera_type": "Other"}, PLACE),
        (run(1), DETAILS, RunPlace("bench@lab", "xyz", "entered")),
    ],
)
def test_what_cannot_be_compared_is_never_in_one_chart(other, details, place):
    grouped = group_runs([*indexed(run(0)), *indexed(other, details=details, place=place)])
    assert [len(group.runs) for group in grouped.groups] == [1, 1]


def test_a_type_has_charts_of_its_own_if_it_has_several_cameras():
    both = indexed(run(0), run(1, camera="2"), run(2, camera="2"))
    levels = [(g.key.level, g.key.serial, len(g.runs)) for g in group_runs(both).groups]
    assert levels == [("type", "", 3), ("camera", "1", 1), ("camera", "2", 2)]
    assert [g.key.level for g in group_runs(both, "type").groups] == ["type"]
    assert [g.key.level for g in group_runs(indexed(run(0)), "type").groups] == ["type"]


def test_runs_in_no_chart_are_counted_and_named():
    runs = indexed(
        run(0), run(1, parameters={}), run(2, fx=math.nan), run(3, sigma=0.0), run(4, sigma=math.inf),
        run(5, begun_utc=""), run(6, fx=math.inf),
    )  # fmt: skip
    grouped = group_runs(runs)
    assert sum(len(group.runs) for group in grouped.groups) == 1
    named = [re.findall(r"run-\d", sentence) for sentence in grouped.left_out]
    assert named == [["run-1"], ["run-2", "run-3", "run-4", "run-6"], ["run-5"]]
    assert [sentence.split()[0] for sentence in grouped.left_out] == ["1", "4", "1"]


def test_a_lasting_shift_an_outlier_and_a_drift_are_out_of_control():
    rng = np.random.default_rng(3)
    shifted = find_charts([steady(60, rng, shift=lambda n, _: 3.0 * (n >= 40))])
    assert chart_of(shifted)["state"] == "out of control"
    outlier = find_charts([steady(60, rng, shift=lambda n, _: 9.0 * (n == 30))])
    assert 30 in chart_of(outlier)["beyond"]
    assert "run-30" in chart_of(outlier)["verdict"]
    drifting = find_charts([steady(60, rng, shift=lambda n, _: 0.1 * n)])
    assert drifting["groups"][0]["verdict"] == "Out of control: fx. Significant drift: fx."
    assert "It drifts with time: +" in chart_of(drifting)["verdict"]
    assert "px per day" in chart_of(drifting)["verdict"]


def test_a_false_alarm_on_a_page_of_many_charts_is_rare():
    """5 % of the pages at most, for control and for drift alike; single values beyond a limit are only to be checked."""
    rng, pages = np.random.default_rng(4), 60
    names = [f"p{n}" for n in range(8)]
    made = [find_charts([steady(25, rng, names)])["groups"][0] for _ in range(pages)]
    assert sum(group["state"] == "out of control" for group in made) <= 9  # 3 expected, 9 is 3.5 sigma
    drifts = [[c["drift"][s] or {} for c in g["parameters"] for s in ("per_day", "per_c")] for g in made]
    assert sum(any(drift.get("seen") for drift in of_page) for of_page in drifts) <= 9
    assert sum(group["state"] == "check" for group in made) > 5


def test_few_runs_have_values_but_no_limits():
    for count in (1, 2, 4):
        page = find_charts([steady(count, np.random.default_rng(5))])
        assert chart_of(page)["state"] == "too few"
        assert "too few for limits" in chart_of(page)["verdict"]
        assert "too few runs" in render_charts(page)
    verdict = chart_of(find_charts([steady(5, np.random.default_rng(6))]))["verdict"]
    assert "provisional until there are 20" in verdict


def test_a_camera_whose_runs_scatter_more_than_stated_is_told():
    group = steady(30, np.random.default_rng(8))
    stated = [{"fx": run.parameters["fx"]._replace(sigma=0.2)} for run in group.runs]
    group.runs = [replace(run, parameters=fx) for run, fx in zip(group.runs, stated, strict=True)]
    assert "their stated uncertainties" in chart_of(find_charts([group]))["verdict"]


def test_the_page_loads_nothing_and_no_text_becomes_markup():
    evil = "<script>alert(1)</script>"
    group = steady(10, np.random.default_rng(9))
    runs = [replace(run, run=evil) for run in group.runs]
    group = ChartGroup(group.key._replace(serial=evil, station=evil), runs)
    html = render_charts(find_charts([group]), [evil], [evil])
    structure = Structure(html)
    assert "script" not in structure.tags
    assert structure.links == []
    assert "@import" not in html
