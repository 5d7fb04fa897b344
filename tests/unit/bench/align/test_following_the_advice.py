"""From out of focus, off centre and unrolled: whoever does what the advice says ends with a recording that passes."""

import dataclasses
import re

import numpy as np
import pytest

from bench.align.live_figures import LiveMeter, LiveSetting, LiveSlice
from bench.stations.station import load_station
from bench.views.camera_kinds import EventKind
from bench.views.measure import edge_angle_deg, measure
from drivers.camera import RecordingFacts
from drivers.camera.raw_file import RawFile
from sequences.schema import GateConfig
from sequences.script import Gates
from simulators.optics.lens_focus import blur_px, signed_blur_px
from simulators.world.truth import LensTruth
from tests.support.live_slices import bench, drive, seen, write_slice

STATION = load_station("simulated").value


class Person:
    """Does what the first sentences of the advice say; knows nothing else about the bench."""

    def __init__(self, ring, **angles):
        self.ring, self.angles, self.roll, self.level, self.on = ring, angles, 0.4, 100.0, False
        self.step, self.last_width = 0.1, None
        self.said = []

    def truth(self):
        lens = LensTruth(focus_distance_m=1.0 / self.ring if abs(self.ring) > 1e-6 else None)
        return dataclasses.replace(bench(roll_deg=self.roll), lens=lens)

    def obey(self, figures):
        first = figures.advice[0]
        self.said.append(first)
        if "switch" in first and "on" in first and not self.on:
            self.on = True
        elif "level to 100 %" in first:
            self.level = 100.0
        elif "Turn the focus ring" in first:
            width = figures.focus["edge_width_px"] or 0.5 / figures.focus["coarse_detail"]
            if self.last_width is not None and width > 1.04 * self.last_width:  # it got worse: back, by less
                self.step *= -0.6 if abs(self.step) > 0.03 else -1.0
            self.last_width = width
            self.ring += self.step
        elif turns := re.findall(r"(pan|tilt) by ([-+][\d.]+) degrees", first):
            for axis, by in turns:
                self.angles[axis] += float(by)
        elif first.startswith("Roll the camera"):
            self.roll += 10.0
        else:
            pytest.fail(f"Nobody can do this: {first}")


@pytest.mark.slow
@pytest.mark.parametrize("ring", [0.8, -0.25])
def test_the_advice_leads_to_a_recording_that_passes(tmp_path, ring):
    person = Person(ring, pan=5.0, tilt=-3.0)
    assert blur_px(person.truth()) > 4.0
    meter = LiveMeter(stars_every_s=0.0)
    path = tmp_path / "slice.raw"
    for number in range(60):
        light = drive(person.level, output=person.on, sync=person.on)
        write_slice(path, seen(person.truth(), **person.angles), light=light, seed=number, triggers=person.on)
        setting = LiveSetting.of_station(
            STATION, frequency_hz=60.0, light_on=person.on, level_percent=person.level
        )
        _, figures = meter.measure(LiveSlice(path, 100.0 * number, None, dict(person.angles)), setting)
        if not figures.advice:
            break
        person.obey(figures)
    assert figures.advice == (), person.said
    assert abs(signed_blur_px(person.truth())) < 4.0
    write_slice(path, seen(person.truth(), **person.angles), light=drive(person.level), periods=2)
    found = measure(
        path, name="end", target=STATION.target.pattern(), image="auto", periods=2, expected_hz=60.0
    )
    assert found.fault == ""
    assert edge_angle_deg(np.array(found.facts["grid"])) > 5.0
    events, triggers = RawFile.open(path).read()
    facts = RecordingFacts("1", "EVK4", 1280, 720, 1, 0.051, len(events.t), len(triggers.t), {}, {})
    step = type("Step", (), {"gates": Gates.from_settings(dict(GateConfig()))})
    gates, reasons = EventKind({}).judge(dataclasses.asdict(facts), step, 60.0, found)
    assert [gate.name for gate in gates if gate.verdict == "fail"] == []
    assert reasons == []
