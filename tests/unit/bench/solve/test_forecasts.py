"""Forecasts of plans and of `until`: limits that cannot be met, suggested poses, and how they are printed."""

import json
import re

import pytest
from calling import out_of

from bench.plan.plan import SHIPPED_SEQUENCES, load_documents, make_plan
from bench.solve.expectations import expected_uncertainty
from bench.solve.forecasts import forecast_bench, suggest_poses
from bench.stations.station import SHIPPED_STATIONS
from calib.model.camera import distortion_names
from calib.studies.pose_gains import distance_deg

NINE = (SHIPPED_SEQUENCES / "nine_pose.yaml").read_text()


def plan(sequence, station="simulated"):
    return make_plan(*load_documents(sequence, station))


@pytest.fixture
def solved(tmp_path):
    """The plan of nine poses with another solve step."""

    def write(step):
        (tmp_path / "nine.yaml").write_text(re.sub("- solve: .*", f"- solve: {step}", NINE))
        return plan(str(tmp_path / "nine.yaml"))

    return write


def test_a_plan_is_forecast_as_its_last_solve_step_calibrates(solved):
    bench = forecast_bench(solved("{distortion: [k1, k2, p1, p2]}"))
    assert tuple(bench.camera.distortion) == distortion_names("k1k2p1p2")
    assert bench.passport.is_certificate
    assert bench.readings.parallax is not None
    assert {term.kind for term in bench.terms} >= {"print_scale", "print_bow", "effective_radius"}
    witness = forecast_bench(solved("{readings: witness}"))
    assert witness.readings is None
    alone = forecast_bench(solved("{passport: none}"))
    assert alone.passport is None


def test_a_limit_that_cannot_be_met_is_named_with_its_term(solved):
    solve = "{passport: none, readings: witness, limits: {expanded_fx_px: 1, sigma_k2: 1e-9, rms_px: 9}}"
    forecast = expected_uncertainty(solved(solve))
    k2, fx, alone = forecast.remarks
    assert fx.startswith("U(fx) of at most 1 px")
    assert "Its largest part is: " in fx
    expected = float(re.search(r": (\S+) expected", fx).group(1))
    assert expected / 2 < float(re.search(r"twice as many .* leave (\S+) px", fx).group(1)) < expected
    assert k2.startswith("sigma_k2 of at most 1e-09")
    assert "Nothing but the stars" in alone


def test_a_limit_that_more_poses_can_meet_says_so(solved):
    (fx, *_) = expected_uncertainty(solved("{limits: {expanded_fx_px: 1.5}}")).remarks
    assert fx.startswith("U(fx) of at most 1.5 px")
    assert re.search(r"twice as many poses would leave 1\.[4-7] px\.$", fx)


def test_suggested_poses_stay_within_limits_and_never_repeat(solved):
    planned = solved("{}")
    taken = [{f"{axis}_deg": angle for axis, angle in pose.angles_deg.items()} for pose in planned.poses]
    for pose in suggest_poses(planned, 3):
        assert min(distance_deg(pose.angles_deg, other) for other in taken) >= 0.2
        assert all(abs(angle) <= 15 for angle in pose.angles_deg.values())
        taken.append(pose.angles_deg)


def test_the_plan_prints_the_expected_uncertainty_with_its_largest_terms(capsys):
    printed = out_of(capsys, "plan", "nine_pose", "-s", "simulated", "--suggest", "1")
    assert "with 9 poses, joint model" in printed
    assert "U(fx)" in printed
    assert "\n  scale and eccentricity of the gimbal  " in printed
    (suggested,) = re.findall(r"\nSuggested: \{pan_deg: .*", printed)
    assert re.search(r"U\(fx\) [\d.]+ px instead of [\d.]+ px, .* \(k = 2[.\d]*\)$", suggested)
    assert "1 sigma" not in printed
    assert "\N{MICRO SIGN}rad" in printed
    answer = json.loads(out_of(capsys, "plan", "nine_pose", "-s", "simulated", "--suggest", "1", "--json"))
    expected = answer["expected"]
    assert expected["poses"] == 9
    assert 1 < expected["expanded_fx_px"] < 2.5
    assert {row["name"] for row in expected["budget_rows"]} >= {"stars", "parallax"}
    assert answer["suggested"][0].keys() == {"pan_deg", "tilt_deg", "worst_px", "rim_share", "why"}


def test_a_large_uncertainty_is_printed_without_an_exponent(tmp_path, capsys):
    """Poses close together, without a certificate, leave U of fx at 130 px."""
    narrow = (
        (SHIPPED_SEQUENCES / "three_pose.yaml").read_text().replace("6, tilt_deg: 2}", "0.5, tilt_deg: 0.5}")
    )
    narrow = narrow.replace("tilt_deg: -3}", "tilt_deg: -0.5}")
    (tmp_path / "narrow.yaml").write_text(
        narrow.replace("- solve: {", "- solve: {passport: none, readings: witness, ")
    )
    printed = out_of(capsys, "plan", tmp_path / "narrow.yaml", "-s", "simulated")
    assert re.search(r"U\(fx\) \d{3,} px", printed)
    assert "e+" not in printed


def test_the_plan_says_why_nothing_can_be_predicted(tmp_path, capsys):
    station = (SHIPPED_STATIONS / "simulated.yaml").read_text()
    (tmp_path / "large.yaml").write_text(f"{station}\ntarget: {{pitch_mm: 40}}\n")
    printed = out_of(capsys, "plan", "three_pose", "-s", tmp_path / "large.yaml")
    assert "pose 1: The tag will not be completely in the image" in printed


# ---------------------------------------------------------------- poses that an until is expected to need

GOAL = "sequence.steps.1.until."


def expected(sequence="until_good", station="simulated", **settings):
    paths = {GOAL + name: str(value) for name, value in settings.items()}
    return expected_uncertainty(make_plan(*load_documents(sequence, station, paths)))


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
def test_a_smaller_goal_takes_more_poses_and_one_that_cannot_be_reached_is_said():
    forecast = expected(expanded_fx_px=1.8)
    (course,) = forecast.courses
    assert 4 <= course.poses <= 15
    (below,) = expected(expanded_fx_px=0.5).courses
    assert re.search(r"cannot .* 0\.5 px\. With all 25 poses, .* about 1", below.text)
    assert re.search("Its largest part is: (parallax|scale and eccentricity|readings)", below.text)
    (beyond,) = expected(station="simulated_ideal", expanded_fx_px=0.001, at_most=5).courses
    assert (below.poses, beyond.poses) == (None, None)
    assert beyond.text.startswith("Expected: 5 poses do not suffice")
    assert "after about 5 poses" in beyond.text
    assert expected("three_pose").courses == ()


@pytest.mark.slow
@pytest.mark.usefixtures("coarse")
def test_a_second_until_goes_on_from_the_poses_of_the_first(tmp_path):
    text = (SHIPPED_SEQUENCES / "until_good.yaml").read_text()
    second = "  - until: {expanded_fx_px: 1.8, at_most: 10}\n  - light: off\n"
    (tmp_path / "two.yaml").write_text(text.replace("2.5", "1.9").replace("  - light: off\n", second))
    first, then = expected_uncertainty(plan(str(tmp_path / "two.yaml"))).courses
    (alone,) = expected(expanded_fx_px=1.8).courses
    assert first.poses + then.poses == alone.poses
