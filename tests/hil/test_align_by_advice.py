"""A person who follows only the advice of the align page ends with a bench that passes the checks of a run.

The bench is out of focus, off-centre and not rolled. The person (`obedient`) jogs, turns the lens and rolls the camera.
The simulated truth is looked at only afterwards.
"""

import math

import pytest
from align_fakes import wait_until
from obedient import Obedient
from running import starbench

from bench.align.page_requests import PageFiles, actions
from bench.align.readiness import check_readiness
from bench.align.session import Session
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.run.states import preflight
from bench.stations.station import SHIPPED_STATIONS, load_station
from sequences.reader import find_document

STATION, COPY = "simulated_unaligned", "mine.yaml"


def devices_answer(session):
    bench = session.bench
    late = bench.devices.late.values()
    return all(one.state == "open" for one in late) and not (
        bench.stage.failure or bench.light.reading.failure
    )


def aligned_by_advice(settings, seed, patience_s, folder):
    """Align and write a copy of the station; return what was done and found, and lens and mount."""
    of_station = {f"station.{path}": text for path, text in settings.items()}
    session = Session(load_station(STATION, settings), seed=seed)
    assert session.open() is None
    wait_until(lambda: devices_answer(session), 60.0)
    try:
        person = Obedient(session, patience_s=patience_s)
        left = person.align()
        checks = check_readiness(session)
        do = actions(session, PageFiles(str(find_document(STATION, SHIPPED_STATIONS)), folder))
        wanted = {"kind": "station", "what": ["zero", "biases", "light"], "copy": COPY}
        do["write"]("person", {**wanted, "mark": do["propose"]("person", wanted)["mark"]})
        job = Job.from_plan(
            make_plan(*load_documents("three_pose", STATION, of_station)), seed=seed, operator=None
        )
        bench = session.bench
        found = bench.loop.on_camera(lambda: preflight(bench.devices, job)).result(timeout=60.0)
        truth = bench.devices.truth()
        angles = dict(bench.devices.stage.position_deg())
    finally:
        confirmed = session.close()
    assert all(one.safe for one in confirmed)
    return person.done, left, checks, found, truth, angles


@pytest.mark.slow
@pytest.mark.parametrize(
    ("seed", "settings"),
    [
        (1, {}),
        (2, {"simulation.lens.focus_distance_m": "0.5", "simulation.optics.mounting_deg": "[-4, 6.5, 2]"}),
        (3, {"simulation.lens.focus_distance_m": "-3.3", "simulation.optics.mounting_deg": "[3, -3, -1]"}),
    ],
    ids=["as shipped", "tag out of view, far out of focus", "beyond infinity, other side"],
)
def test_following_only_the_advice_ends_in_a_file_that_runs(seed, settings, tmp_path):
    done, left, checks, found, truth, angles = aligned_by_advice(settings, seed, 500.0, tmp_path)
    assert left == []
    kinds = {step.split()[0] for step in done}
    assert kinds >= {"light", "ring", "jog", "roll"}
    # the checks of a run, with one recording of the present pose through the default gates
    assert [check for check in checks if check.verdict != "good"] == []
    assert {check.name for check in checks} >= {"recording: stars", "recording: event rate", "stage: faults"}
    assert found["camera"]["serial"] == "00050423"
    # what the person could not know
    assert truth["lens"]["blur_px"] < 4.5
    assert math.hypot(*truth["mount"]["turn_deg"][:2]) == 0.0
    pan, tilt, roll = truth["optics"]["mounting_deg"]
    assert abs(roll + truth["mount"]["turn_deg"][2]) == pytest.approx(10.0, abs=3.0)
    assert math.hypot(angles["pan"] + tilt, angles["tilt"] + pan) < 1.2
    if not settings:  # the copy is one of the shipped file
        run = starbench(
            "run", "three_pose", "--station", tmp_path / COPY, "-o", tmp_path / "run", home=tmp_path
        )
        assert run.returncode == 0, run.stderr
