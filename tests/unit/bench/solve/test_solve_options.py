"""How a solve step of a run is calibrated: readings of the gimbal, and why they enter or not."""

from dataclasses import replace

import pytest
from expected_stars import expected_views

from bench.measure.gates import solution_gates
from bench.plan.job import Job
from bench.report.run_tables import readings_rows
from bench.solve.solve_options import (
    NO_SECTION,
    gimbal_readings,
    limited_numbers,
    readings_result,
    solve_options,
)
from calib.engine import calibrate
from sequences.script import SolveStep

GIMBAL = "{reading_sigma_deg: 0.002, scale_sigma: 1e-4, source: G-3%s}"
OFF_PIVOT = ", pupil_off_pivot_mm: {value: 2, sigma: 0.5}"
DEFOCUS = "{value: 0.06, sigma: 0.01}"
POSES = [(pan, tilt) for tilt in (-2.5, 0, 2.5) for pan in (-6, 0, 6)]


def job(gimbal: str | None, defocus: str | None = DEFOCUS) -> Job:
    settings = {
        "station.gimbal": gimbal or "",
        "station.collimator.defocus": defocus or "",
        "station.collimator.certificate": "",
    }
    return Job.from_files("nine_pose", "simulated_ideal", seed=1, operator=None, settings=settings)


def solved(task: Job, measured_deg=None, **settings):
    """Calibrate nine predicted poses as the task's solve step does, with other settings of the step."""
    poses = [(f"{pan} {tilt}", pan, tilt) for pan, tilt in POSES]
    views = expected_views(poses, sigma_px=0.02, seed=3, station=task.plan.station)
    (step,) = (step for step in task.steps if isinstance(step, SolveStep))
    step = replace(step, **{"model": "auto", **settings})
    read = measured_deg or [{"pan": float(pan), "tilt": float(tilt)} for pan, tilt in POSES]
    options = solve_options(task, step, read)
    calibration = calibrate(views, options)
    stated, witness = task.station.gimbal is not None, step.readings == "witness"
    return calibration, options, readings_result(calibration, options, witness=witness, stated=stated)


@pytest.fixture(scope="module")
def without_section():
    return solved(job(None))


def test_encoders_replace_the_readings_of_their_axes():
    task = job(GIMBAL % OFF_PIVOT)
    statement = gimbal_readings(task.station, [{"pan": 1.0, "pan_encoder": 1.1, "tilt": 2.0}])
    assert statement.angles_deg == ({"pan_deg": 1.1, "tilt_deg": 2.0},)
    assert (statement.reading_sigma_deg, statement.scale_sigma, statement.source) == (0.002, 1e-4, "G-3")
    assert (statement.parallax.defocus, statement.parallax.pupil_off_pivot_sigma_mm) == (0.06, 0.5)


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        (None, NO_SECTION),
        ({"readings": "witness"}, "The sequence keeps them out"),
        ({"model": "planar"}, "The planar model frees the centre"),
    ],
    ids=["no section", "witness", "planar"],
)
def test_readings_that_do_not_enter_say_why_not(without_section, settings, why):
    _, _, readings = without_section if settings is None else solved(job(GIMBAL % OFF_PIVOT), **settings)
    assert readings.entered is False
    assert readings.why_not.startswith(why)
    (first, *_) = readings_rows(readings, None)
    assert first[0] == "Gimbal readings"
    assert why in first[1]


def test_readings_with_a_bound_enter_and_the_report_says_how_they_agree():
    calibration, options, readings = solved(job(GIMBAL % OFF_PIVOT))
    assert readings.entered is True
    assert readings.statement.source == "G-3"
    assert readings.bound["parallax"] == pytest.approx(-0.06 * 2 / calibration.collimator.r)
    rows = dict(readings_rows(readings, calibration.gimbal))
    assert "chi-square" in rows["Gimbal readings"]
    assert "\N{MINUS SIGN}0.047 % of the focal length" in rows["Uncertainty of the readings"]
    assert options.gimbal is not None


def test_readings_with_a_wrong_scale_are_named():
    scaled = [{"pan": 1.05 * pan, "tilt": float(tilt)} for pan, tilt in POSES]
    _, _, readings = solved(job(GIMBAL % OFF_PIVOT), scaled)
    assert readings.entered is False
    assert "They contradict the stars" in readings.why_not


def test_limits_judge_expanded_uncertainties_and_the_worst_corner(without_section):
    calibration, _, _ = without_section
    numbers = limited_numbers(calibration)
    k = calibration.coverage_factor
    assert numbers["expanded_fx"] == pytest.approx(k * calibration.sigma["fx"])
    assert numbers["worst_corner"] > 0
    gates = solution_gates({"expanded_fx_px": 1e-6, "worst_corner_px": 100, "sigma_k1": 1}, numbers)
    assert [(gate.name, gate.verdict) for gate in gates] == [
        ("expanded fx", "fail"),
        ("worst corner", "pass"),
        ("sigma k1", "pass"),
    ]
