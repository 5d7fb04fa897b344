"""From out of focus, off centre and unrolled: whoever does what the advice says ends with a recording that passes."""

import dataclasses

import numpy as np
import pytest

from bench.measure.camera_kinds import EventKind
from bench.measure.measure import edge_angle_deg, measure
from bench.stations.station import load_station
from drivers.camera import RecordingFacts
from drivers.camera.raw_file import RawFile
from sequences.schema import GateConfig
from sequences.script import Gates
from simulators.optics.lens_focus import blur_px, signed_blur_px
from tests.support.blind_follower import BlindFollower
from tests.support.live_slices import drive, seen, write_slice

STATION = load_station("simulated").value


@pytest.mark.slow
@pytest.mark.parametrize("ring", [0.8, -0.25])
def test_the_advice_leads_to_a_recording_that_passes(tmp_path, ring):
    person = BlindFollower(ring, {"pan": 5.0, "tilt": -3.0})
    assert blur_px(person.truth()) > 4.0
    figures = person.align(STATION, tmp_path)
    assert figures.advice == (), person.instructions
    assert len(person.instructions) <= 10, person.instructions
    assert abs(signed_blur_px(person.truth())) < 4.0
    path = tmp_path / "end.raw"
    write_slice(path, seen(person.truth(), **person.angles), light=drive(person.level), periods=2)
    measurement = measure(
        path, name="end", target=STATION.target.pattern(), image="auto", periods=2, expected_hz=60.0
    )
    assert measurement.fault == ""
    assert edge_angle_deg(np.array(measurement.facts["grid"])) > 5.0
    events, triggers = RawFile.open(path).read()
    facts = RecordingFacts("1", "EVK4", 1280, 720, 1, 0.051, len(events.t), len(triggers.t), {}, {})
    step = type("Step", (), {"gates": Gates.from_settings(dict(GateConfig()))})
    gates, reasons = EventKind({}).judge(dataclasses.asdict(facts), step, 60.0, measurement)
    assert [gate.name for gate in gates if gate.verdict == "fail"] == []
    assert reasons == []
