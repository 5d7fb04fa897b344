"""The certificate of a planar calibration speaks of points and of the board, never of stars."""

import copy
import re

from bench.certificate.compose import compose
from bench.certificate.dcc import render_dcc
from bench.certificate.pdf_plots import draw_plots, pictures
from bench.report.text import BOARD, STARS
from tests.support.certificate_sample import identity, sample_lab, sample_results

STAR = re.compile(r"(?<![\w-])[Ss]tars?\b")
WRITTEN_BY_THE_LABORATORY = ("Camera before a collimator with a star target", "coordinates of the stars")


def of_board():
    found = copy.deepcopy(sample_results())
    found["run"] |= {"board": "checkerboard:11x7:20mm"}
    calibration = found["calibration"]
    calibration["budget"] = {"stars": calibration["sigma"]}  # a planar calibration knows no other source
    calibration["budget_rows"] = [row for row in calibration["budget_rows"] if row["name"] == "stars"]
    calibration["notes"] = []
    found["passport"] = None
    found["gates"] = [{"name": "pose 1: stars", "value": 7, "unit": "", "limit": ">= 39", "verdict": "fail"}]
    return found


def texts(value):
    if isinstance(value, str):
        return [value]
    if isinstance(value, dict):
        return [text for one in value.values() for text in texts(one)]
    return [text for one in value for text in texts(one)] if isinstance(value, (list, tuple)) else []


def with_stars(found):
    said = texts(compose(found, sample_lab().value, identity()).to_json().decode())
    return [
        line
        for line in said[0].splitlines()
        if STAR.search(re.sub("|".join(WRITTEN_BY_THE_LABORATORY), "", line))
    ]


def test_a_certificate_of_a_board_says_points_and_names_the_board():
    assert with_stars(sample_results())  # else the pattern is of no use
    assert with_stars(of_board()) == []
    made = compose(of_board(), sample_lab().value, identity())
    assert {row.name for budget in made.budgets for row in budget.rows} >= {"points"}
    assert "Limit not met: pose 1: points is 7, limit >= 39." in [one.text for one in made.deviations]
    assert ("board", "checkerboard:11x7:20mm") in [(one.name, one.text) for one in made.conditions]


def test_the_digital_certificate_says_the_same():
    dcc = render_dcc(compose(of_board(), sample_lab().value, identity())).decode()
    for text in WRITTEN_BY_THE_LABORATORY:
        dcc = dcc.replace(text, "")
    assert not [line for line in dcc.splitlines() if STAR.search(line)]
    assert "checkerboard:11x7:20mm" in dcc


def test_captions_of_the_plots_fit_the_target():
    made = compose(of_board(), sample_lab().value, identity())
    plots = dict.fromkeys(("coverage", "vectors", "regions"), "<svg/>")
    assert [one.name for one in pictures(made, plots, STARS) if STAR.search(one.caption)] == list(plots)
    assert [one.name for one in pictures(made, plots, BOARD) if STAR.search(one.caption + one.alt)] == []
    assert set(draw_plots(of_board())) == set(draw_plots(sample_results()))
