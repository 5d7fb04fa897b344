"""Decisions of an `until`: when it ends and with which words, and that its choice is within limits and never a repeat."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bench.plan.job import Job
from bench.record.history import History
from bench.solve import interim
from bench.solve.forecasts import expected_bench
from bench.solve.interim import Interim, decide
from bench.solve.next_pose import Choice, Wish, choose_pose
from bench.solve.solve_options import gimbal_readings
from bench.stations.station import load_station
from calib.model.gimbal import Gimbal
from calib.model.gimbal_readings import angles_of
from calib.model.passport import Passport
from calib.model.result_parts import BudgetRow
from calib.model.rotation import euler_zxy
from calib.studies.planning import PoseWeigher, fit_gimbal
from sequences.script import ChooseStep

TAKEN = [
    {"pan_deg": -6.0, "tilt_deg": 2.0},
    {"pan_deg": 6.0, "tilt_deg": 2.0},
    {"pan_deg": 0.0, "tilt_deg": -3.0},
]
WANTED = {"expanded_fx_px": 2.0, "worst_corner_px": 0.3}


@pytest.fixture(scope="module")
def job():
    goals = {f"sequence.steps.1.until.{name}": str(goal) for name, goal in WANTED.items()}
    return Job.from_files("until_good", "simulated", seed=1, operator=None, settings=goals)


def wish(**changes):
    given = {"wanted": WANTED, "now": {}, "roll": False, "needs_tag": True, "min_stars": 40}
    return Wish(**(given | changes))


def choose(taken=TAKEN, refused=(), station="simulated", **changes):
    return choose_pose(
        load_station(station), None, None, taken_deg=taken, refused_deg=list(refused), wish=wish(**changes)
    )


class HistoryOf(History):
    """A history with as many accepted recordings as a test says, and failed poses."""

    def __init__(self, accepted, chosen=0, worked_s=0.0):
        super().__init__()
        for index in accepted:
            stored = {"measured_deg": {"pan": float(index), "tilt": 0.0}}
            self.add(SimpleNamespace(stored=stored, pose_index=index, accepted=True))
        self.worked_s = {5: worked_s, 1: 1000.0}
        poses = [{"pose": 4 + i, "angles_deg": {"pan": 9.0 - i, "tilt": 0.0}} for i in range(chosen)]
        self.decisions = [{"step": 0, "until": 2, "until_last": 999, "chosen": pose} for pose in poses]


def calibration(fx=1.0, corner=0.2, gimbal=None, **parts):
    """A calibration with these contributions to the standard uncertainty of fx; a tenth of each at the corners."""
    rows = [
        BudgetRow(name.replace("_", " "), "A", "test", contribution={"fx": part, "worst_corner": part / 10})
        for name, part in (parts or {"stars": fx / 2}).items()
    ]
    expanded = (fx, corner)
    return SimpleNamespace(
        coverage_factor=2.0, model="radial", gimbal=gimbal, budget_rows=rows, expanded=expanded
    )


CHOSEN = Choice(
    {"pan_deg": 1.25, "tilt_deg": -2.0},
    {"expanded_fx_px": 1.5, "worst_corner_px": np.inf},
    {"expanded_fx_px": 1.2, "worst_corner_px": 0.2},
    "",
    "it",
)


@pytest.fixture
def numbers(monkeypatch):
    monkeypatch.setattr(
        interim,
        "limited_numbers",
        lambda calibrated: dict(zip(("expanded_fx", "worst_corner"), calibrated.expanded, strict=True)),
    )
    monkeypatch.setattr(interim, "choose_pose", lambda *_, **__: CHOSEN)


def decided(job, history, calibrated, *, last=False):
    steps = [step for step in job.steps if isinstance(step, ChooseStep)]
    made = Interim([], calibrated, "" if calibrated else "Too few stars.")
    return decide(steps[-1] if last else steps[0], job, history, made)


@pytest.mark.usefixtures("numbers")
def test_it_chooses_while_one_goal_is_missed_and_ends_when_every_goal_is_met(job):
    decision = decided(job, HistoryOf([1, 2, 3], worked_s=7.5), calibration(1.9, 0.31))
    assert "ended" not in decision
    pose = {"pose": 4, "pose_name": "chosen 1", "angles_deg": {"pan": 1.25, "tilt": -2.0}}
    assert decision["chosen"] == {**pose, "expected": {"expanded_fx_px": 1.5}, "why": "it"}
    assert (decision["recorded"], decision["poses"], decision["worked_s"]) == (3, 3, 7.5)
    decision = decided(job, HistoryOf([1, 2, 3]), calibration(1.9, 0.3))
    assert (decision["ended"], decision["why"]) == ("met", "The goals are met.")
    assert "chosen" not in decision


@pytest.mark.usefixtures("numbers")
def test_a_goal_out_of_reach_ends_it_when_poses_hardly_help_and_the_largest_part_is_named(job, monkeypatch):
    calibrated = calibration(2.6, 0.5, stars=0.5, passport_of_the_collimator=1.2, print_scale=0.5)

    def with_all_poses(fx_px):
        late = replace(CHOSEN, at_end={"expanded_fx_px": fx_px, "worst_corner_px": 0.2})
        monkeypatch.setattr(interim, "choose_pose", lambda *_, **__: late)
        return decided(job, HistoryOf([1, 2, 3]), calibrated)

    assert "chosen" in with_all_poses(2.4)  # further poses help
    unknown = with_all_poses(np.inf)
    assert "chosen" in unknown
    assert unknown["at_end"] == {"worst_corner_px": 0.2}
    decision = with_all_poses(2.55)
    assert (decision["ended"], decision["at_end"]["expanded_fx_px"]) == ("unreachable", 2.55)
    fact = r"2\.6 px; .* 2 px\. .* 0\.5 px; .* 0\.3 px\. With all 25 poses, .* 2\.5 px\. .*: passport of the collimator, 2\.4 px"
    assert re.search(fact, decision["why"])


@pytest.mark.usefixtures("coarse")
def test_more_poses_allowed_leave_less_and_stop_at_what_a_certificate_leaves():
    coarse = Passport.of_radius(255.0, 1.0)
    left = [
        choose_pose(
            load_station("simulated"), None, coarse, taken_deg=TAKEN, refused_deg=[], wish=wish(more=more)
        ).at_end["expanded_fx_px"]
        for more in (1, 4, 20)
    ]
    assert left[0] > left[1] > left[2] > 2.0


@pytest.mark.usefixtures("numbers")
def test_the_bounds_end_it_with_what_is_missed_and_what_contributes_most(job):
    calibrated = calibration(4.5, 0.2, stars=1.0, disagreement_of_the_views=2.0)
    decision = decided(job, HistoryOf(range(1, 26)), calibrated)
    assert decision["ended"] == "at_most"
    assert re.search(r"4\.5 px; .* 2 px\. 25 .*: disagreement of the views, 4\.0 px", decision["why"])
    assert decided(job, HistoryOf([1, 2, 3], chosen=10), calibrated)["ended"] == "failures"
    assert "chosen" in decided(job, HistoryOf([1, 2, 3], chosen=9), calibrated)
    assert decided(job, HistoryOf([1, 2, 3], worked_s=1200.0), calibrated)["ended"] == "minutes"
    assert "chosen" in decided(job, HistoryOf([1, 2, 3], worked_s=1199.0), calibrated)


@pytest.mark.usefixtures("numbers")
def test_without_a_calibration_it_goes_on_and_names_its_goals_and_why_at_the_end(job, monkeypatch):
    assert "chosen" in decided(job, HistoryOf([1]), None)
    monkeypatch.setattr(interim, "choose_pose", lambda *_, **__: "No pose is left.")
    decision = decided(job, HistoryOf([1]), None)
    assert decision["ended"] == "no_pose"
    assert re.search(r"2 px\. .* 0\.3 px\. Too few stars\. ", decision["why"])
    assert decision["now"] == {}
    assert decision["problem"] == "Too few stars."


@pytest.mark.usefixtures("coarse")
def test_the_choice_is_the_same_each_time_and_within_the_limits():
    first, second = choose(), choose()
    assert first == second
    for axis, config in load_station("simulated").value.axes.items():
        assert config.limits_deg[0] <= first.angles_deg[f"{axis}_deg"] <= config.limits_deg[1]
    assert set(first.expected) == set(WANTED)
    assert first.why == "it lowers U(fx) most"


@pytest.mark.usefixtures("coarse")
def test_no_pose_is_repeated_and_no_failed_pose_chosen_again():
    taken, refused = list(TAKEN), []
    for number in range(4):
        angles = dict(choose(taken, refused).angles_deg)
        others = [*taken, *refused]
        assert all(max(abs(angles[axis] - other[axis]) for axis in angles) >= 0.2 for other in others)
        (refused if number % 3 == 2 else taken).append(angles)


@pytest.mark.usefixtures("coarse")
def test_readings_that_enter_count_in_the_choice_of_the_next_pose():
    station = load_station("simulated")
    readings = gimbal_readings(station.value, [])
    after_px = {
        entering: choose_pose(
            station, None, None, taken_deg=TAKEN, refused_deg=[], wish=wish(), readings=entering
        ).expected["expanded_fx_px"]
        for entering in (None, readings)
    }
    assert after_px[readings] < 0.97 * after_px[None]


def test_no_pose_left_is_said():
    assert "within the limits" in choose(min_stars=100_000)


def test_without_calibration_and_expectations_nothing_can_be_predicted(tmp_path):
    shipped = load_station("simulated")
    value = shipped.value.model_copy(update={"expected": None})
    reason = choose_pose(
        replace(shipped, value=value), None, None, taken_deg=TAKEN, refused_deg=[], wish=wish()
    )
    assert "no expected section" in reason


def test_a_mounting_turned_by_a_quarter_is_found_from_the_views():
    readings = [{"pan_deg": p, "tilt_deg": t} for p, t in ((-6, 2), (6, 2), (0, -3), (3, 1))]
    mounting = euler_zxy(1.0, -2.0, 90.0)
    base = euler_zxy(-1.5, 0.5, -90.0)
    rotations = np.array([mounting @ euler_zxy(r["pan_deg"], r["tilt_deg"]) @ base for r in readings])
    model = fit_gimbal(rotations, readings)
    here = {"pan_deg": 4.0, "tilt_deg": -4.0}
    assert model.rotations(angles_of([here]))[0] == pytest.approx(
        mounting @ euler_zxy(4.0, -4.0) @ base, abs=1e-4
    )
    straight = fit_gimbal(rotations[:1], readings[:1])
    assert straight.rotations(angles_of(readings[:1]))[0] == pytest.approx(rotations[0], abs=1e-9)
    assert fit_gimbal(np.zeros((0, 3, 3)), []).rotations(angles_of([{}]))[0] == pytest.approx(np.eye(3))


def test_poses_that_turn_an_axis_by_little_are_weighed_with_the_readings_of_the_recorded_ones():
    station = load_station("simulated")
    bench = replace(expected_bench(station), readings=gimbal_readings(station.value, []))
    weigher = PoseWeigher(bench, Gimbal(), TAKEN)
    wide = [{"pan_deg": pan, "tilt_deg": 3.0} for pan in (-4.0, 1.0, 4.0)]
    close = [{"pan_deg": 1.0 + off, "tilt_deg": 3.0} for off in (0.0, 0.1)]
    alone, with_readings = weigher.weigh(close)[0], weigher.weigh(wide)[1]
    assert alone.after.fx_px == pytest.approx(with_readings.after.fx_px, rel=1e-3)
    assert alone.after.fx_px < weigher.before.fx_px
