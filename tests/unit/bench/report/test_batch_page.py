"""The summary of a batch: it says how the results of a camera agree, and the page shows and escapes."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from bench.record.coverage import Estimate, parameters_data
from bench.record.run_facts import IndexedRun
from bench.report.batch_page import render_batch
from bench.solve.agreement import agreements
from tests.unit.bench.report.structure import Structure

EVENING = datetime(2026, 3, 1, 19, tzinfo=UTC)


def run(number, *, fx=0.0, k1=0.0, sigma=0.5, shared=0.0, temperature_c=40.0, camera="1", hours=None):
    begun = EVENING + timedelta(hours=number / 2 if hours is None else hours)
    return IndexedRun(
        folder=f"/runs/r{number:03d}", id=f"r{number:03d}", sequence="s", station="t", camera=camera, operator=None,
        simulated=True, rehearsal=False, begun_utc=begun.isoformat().replace("+00:00", "Z"), how="finished", sealed=True, accepted=9,
        recordings=9, deviations=0, temperature_c=temperature_c, model="spherical", rms_px=0.05,
        parameters={
            "fx": Estimate(3300.0 + fx, sigma, 2.2, shared), "k1": Estimate(0.06 + k1, 0.001, 2.3),
        },
    )  # fmt: skip


# ---------------------------------------------------------------- the page


def item(key, how="finished", why="", **facts):
    as_data = {
        "item": key, "job": key.rpartition("-")[0], "folder": f"runs/{key}", "how": how, "why": why, "attempts": 1,
        "begun_utc": "2026-03-01T19:00:00+00:00", "ended_utc": "2026-03-01T19:10:00+00:00", "took_s": 600.0,
        "report": None, "camera": "1", "poses": 9, "accepted": 9, "recordings": 10, "deviations": 0,
        "temperature_c": None, "model": "spherical", "rms_px": 0.05, "sealed": True,
        "parameters": parameters_data({"fx": Estimate(3300.0, 0.5)}), "ledger_number": None, "ledger_head": None,
        "conformity": None, "goals_missed": [],
    }  # fmt: skip
    as_data["tries"] = [{"begun_utc": as_data["begun_utc"], "ended_utc": as_data["ended_utc"], "how": how}]
    return {**as_data, **facts}


def summary(*items, cameras=(), **facts):
    totals = {
        "runs": len(items), "by_end": {}, "attempts": 1, "poses": 9, "recordings": 10, "deviations": 0, "hours": 1.0,
        "working_hours": 0.5,
    }  # fmt: skip
    return {
        "schema": "starbench/batch/1", "queue": "Night", "zone": "Europe/Berlin", "how": "finished", "why": "",
        "begun_utc": "2026-03-01T19:00:00+00:00", "ended_utc": "2026-03-02T03:00:00+00:00", "simulated": False,
        "rehearsal": False, "totals": totals, "items": list(items), "cameras": list(cameras), "charts": {"groups": []},
        "requests": [], **facts,
    }  # fmt: skip


def of_runs(runs):
    return {
        "camera": "1", "model": "spherical", "runs": len(runs),
        "parameters": agreements(runs),
    }  # fmt: skip


def test_nothing_in_a_summary_becomes_markup():
    evil = "<script>alert(1)</script>"
    request = {"word": "add", "by": evil, "taken": True, "why": "", "job": "x"}
    html = render_batch(summary(item("a-001", "failed", evil), queue=evil, requests=[request]))
    assert "script" not in Structure(html).tags
    assert html.count("&lt;script&gt;") >= 3


def test_the_page_has_the_command_by_which_each_begun_run_goes_on():
    failed = item("cam-1", "failed", "The lamp is open.")
    page = render_batch(summary(failed, item("cam-2", "not begun", begun_utc=None), how="failed"))
    assert "starbench resume runs/cam-1" in page
    assert "resume runs/cam-2" not in page
    assert "starbench resume" not in render_batch(summary(failed, how="failed", rehearsal=True))


def test_the_page_says_in_words_whether_the_results_agree():
    def page(*runs):
        return render_batch(summary(cameras=[of_runs(runs)]))

    noise = np.random.default_rng(3).normal(size=(12, 2))
    steady = page(*(run(n, fx=0.5 * a, k1=0.001 * b) for n, (a, b) in enumerate(noise)))
    assert "All 12 results agree" in steady
    assert "fx scattered more than" in page(*(run(n, fx=2.0 * n) for n in range(12)))
    assert "there is no comparison" in page(run(0))


@pytest.mark.parametrize(
    ("facts", "pill"),
    [
        ({}, '<span class="pill pass">finished</span>'),
        ({"causes": ["The light is weak."]}, '<span class="pill marginal">reservations</span>'),
        ({"goals_missed": ["U(fx) was not reached."]}, '<span class="pill marginal">reservations</span>'),
        ({"conformity": "FAIL", "causes": ["The light is weak."]}, '<span class="pill fail">FAIL</span>'),
        ({"how": "cut off"}, '<span class="pill marginal">cut off</span>'),
        ({"how": "hung"}, '<span class="pill fail">hung</span>'),
    ],
)
def test_a_run_is_green_only_without_any_reservation(facts, pill):
    html = render_batch(summary(item("a-001", **facts)))
    assert pill in html[html.index("All runs") :]


@pytest.mark.parametrize("flag", ["rehearsal", "simulated"])
def test_what_is_not_measured_says_so_at_the_top(flag):
    html = render_batch(summary(item("a-001"), **{flag: True}))
    assert '<div class="simulated-bar">' + flag.upper() in html


def test_the_mean_of_many_runs_is_not_better_than_what_they_share():
    drawn = np.random.default_rng(4)
    runs = [run(n, fx=0.3 * drawn.normal(), sigma=0.5, shared=0.4, hours=0.1 * n) for n in range(60)]
    fx = agreements(runs)[0]
    assert 0.4 < fx["sigma"] < 0.41
    assert fx["expanded"] == 2.2 * fx["sigma"]


def test_runs_that_differ_much_less_than_they_say_are_told_and_their_mean_is_not_better():
    runs = [run(n, fx=0.01 * n, hours=0.1 * n) for n in range(3)]
    page = render_batch(summary(cameras=[of_runs(runs)]))
    assert "not better than one run" in page
    assert "agree within" not in page
    assert '<span class="pill marginal">repeats</span>' in page
    assert agreements(runs)[0]["sigma"] == pytest.approx(0.5, rel=0.01)
