"""The course of an `until` in the report: a row for each decision, a plot, and why it ended."""

from bench.report.pose_tables import courses
from bench.report.run_tables import alerts
from bench.wording.goals import goals_text, missed_text, reached_text
from bench.wording.numbers import MINUS, NOTHING

WANTED = {"expanded_fx_px": 2.0, "worst_corner_px": 0.3}


def decided(poses, fx, corner, *, until=5, **more):
    step = until + 9 + 4 * (poses - 3)
    head = {"step": step, "until": until, "until_last": 200, "wanted": WANTED, "lacks": ""}
    counts = {"recorded": poses, "poses": poses, "worked_s": 60.0 * poses}
    at_end = {"expanded_fx_px": 1.1, "worst_corner_px": 0.2}
    reached = {"now": {}, "at_end": {}, "coverage_factor": None, "model": ""}
    if fx:
        now = {"expanded_fx_px": fx, "worst_corner_px": corner}
        reached = {"now": now, "at_end": at_end, "coverage_factor": 2.1, "model": "radial"}
    return {**head, **counts, **reached, **more}


def chosen(number, expected, why="it lowers U(fx) most"):
    pose = {"pose": number, "pose_name": f"chosen {number - 3}", "angles_deg": {"pan": -1.25, "tilt": 4.0}}
    return {"chosen": {**pose, "expected": expected, "why": why}}


COURSE = [
    decided(3, None, None, **chosen(4, {})),
    decided(4, 5.125, 0.9, **chosen(5, {"expanded_fx_px": 3.5, "worst_corner_px": 0.6}, "the rim")),
    decided(5, 1.9, 0.29, ended="met", why="The goals are met."),
]


def test_every_decision_is_a_row_with_what_was_reached_and_what_follows():
    (course,) = courses(COURSE)
    assert course["columns"] == ["U(fx)", "U at the corners"]
    assert [row["reached"] for row in course["rows"]] == [[NOTHING] * 2, ["5.12", "0.900"], ["1.90", "0.290"]]
    _, second, last = course["rows"]
    assert second["expected"] == ["3.50", "0.600"]
    assert second["angles"] == f"pan {MINUS}1.250, tilt 4.000"
    assert (second["why"], last["why"]) == ("the rim", "the goals are met")
    assert course["end"] == "The goals are met."
    assert course["minutes"] == "5.0"


def test_a_goal_that_was_not_met_is_named_before_the_values():
    course = [*COURSE[:2], decided(5, 2.9, 0.4, ended="minutes", why="Because of the lamp.")]
    sentences = alerts({"untils": course, "calibration": {"notes": []}})
    assert sentences == ["The goal of a step was not met. Because of the lamp."]
    end = courses(course)[0]["end"]
    assert not end.startswith("The goals are met")
    assert "Because of the lamp." in end
    assert alerts({"untils": COURSE, "calibration": {"notes": []}}) == []


def test_a_goal_missed_by_little_is_seen_to_be_missed():
    late = decided(5, 2.0004, 0.3, ended="at_most", why="")
    assert "U(fx) 2.0004 px (wanted 2), U at the corners 0.3 px (wanted 0.3)." in reached_text(late)
    assert missed_text(late["now"], WANTED) == "U(fx) is 2.0004 px; the goal is 2 px."
    (course,) = courses([late])
    assert course["rows"][0]["reached"] == ["2.0004", "0.300"]
    assert "U(fx) 2.0004 px, wanted 2 px" in course["plot"]
    assert goals_text({"expanded_fx_px": 1.4567}) == "U(fx) is at most 1.4567 px"
