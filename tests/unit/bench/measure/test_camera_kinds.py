"""What a run does differently for a frame camera: light, settings, gates, plan."""

from dataclasses import asdict, replace
from unittest.mock import create_autospec

import numpy as np
import pytest
from station_texts import station_of

from bench.measure.camera_kinds import EventKind, camera_kind
from bench.measure.measure import Measurement
from bench.measure.measure_frames import frame_gates, frame_rejection_reasons, measure_frames
from bench.plan.job import Job
from bench.plan.plan import load_documents, make_plan
from bench.stations.station import SHIPPED_STATIONS
from calib.target import StarTarget
from drivers.camera import CameraSettings, EventCamera
from drivers.camera.frames import FrameCamera, FrameFacts, FrameSettings, write_frames
from sequences.script import Gates, LightStep

FRAMES = (SHIPPED_STATIONS / "simulated_frames.yaml").read_text(encoding="utf-8")
STEADY = """\
format: starbench/sequence/1
name: Steady
poses: {two: [{pan_deg: -5, tilt_deg: 1}, {pan_deg: 5}]}
steps:
  - light: {waveform: steady, level_percent: 50}
  - repeat: {poses: two, steps: [move, settle, {record: {window_ms: 1, gates: {require_triggers: true}}}]}
  - light: off
  - solve
  - report
"""

TAKEN = FrameFacts("A7", "double", 640, 480, bits=8, frames=4, bytes=1000, saturated_share=0.0)


@pytest.fixture
def steady(tmp_path) -> str:
    path = tmp_path / "steady.yaml"
    path.write_text(STEADY)
    return str(path)


def test_a_flicker_becomes_steady_light_at_its_high_level_for_a_frame_camera():
    job = Job.from_files("three_pose", "simulated_frames", seed=1, operator=None)
    [flicker] = [s.flicker for s in job.steps if isinstance(s, LightStep) and s.flicker is not None]
    settings = job.light_settings(flicker)
    assert (settings.waveform, settings.high_v) == ("steady", 5.0)
    assert job.camera_name == "opencv"
    event = Job.from_files("three_pose", "simulated", seed=1, operator=None)
    assert event.light_settings(flicker).waveform == "square"


def test_a_plan_notes_that_a_flicker_becomes_steady_light():
    planned = make_plan(*load_documents("three_pose", "simulated_frames"))
    assert not planned.faults
    (remark,) = planned.remarks
    assert "the light is steady" in remark.message
    assert planned.size_bytes > 3 * 8 * 1280 * 720


def test_a_sequence_of_steady_light_is_only_for_frame_cameras(steady):
    for_frames = make_plan(*load_documents(steady, "simulated_frames"))
    assert (for_frames.faults, for_frames.remarks) == ((), ())
    for_events = make_plan(*load_documents(steady, "simulated"))
    assert all("waveform: square" in fault.message for fault in for_events.faults)
    assert for_events.faults


def test_the_settings_of_a_station_reach_its_camera():
    camera = create_autospec(FrameCamera, instance=True)
    camera.apply.return_value = FrameSettings(120.0, None)
    station = station_of(FRAMES.replace("sim:frame-camera", "/dev/video3\n  exposure: 120\n  pictures: 5"))
    kind = camera_kind(station)
    assert kind.prepare(camera) == ({"exposure": 120.0, "gain": None}, [])
    camera.apply.assert_called_once_with(FrameSettings(120.0, None))
    recording = asdict(replace(TAKEN, frames=5, bits=12, saturated_share=0.0002))
    assert kind.conditions([recording]) == {"pictures": 5, "bits": 12, "exposure": 120.0}
    assert kind.counts(recording) == {"pictures": 5, "bits": 12, "saturated_percent": pytest.approx(0.02)}


def test_reasons_against_an_event_camera_are_reported_before_a_run():
    camera = create_autospec(EventCamera, instance=True)
    camera.apply.return_value = CameraSettings({}, trigger_in=False)
    camera.filters.return_value = {"afk": True, "erc": False}
    settings, reasons = EventKind({"bias_fo": 3}, (0, 0, 10, 10)).prepare(camera)
    camera.apply.assert_called_once_with(CameraSettings({"bias_fo": 3}, True, (0, 0, 10, 10)))
    assert settings["trigger_in"] is False
    assert ["AFK" in reasons[0], "trigger input" in reasons[1], len(reasons)] == [True, True, 2]


@pytest.mark.parametrize(
    ("gate", "share", "most_px", "verdict"),
    [
        ("saturated pixels", 0.0, 1.0, "pass"),
        ("saturated pixels", 0.00095, 1.0, "marginal"),
        ("saturated pixels", 0.02, 1.0, "fail"),
        ("stars moved", 0.0, 0.1, "fail"),
        ("stars moved", 0.0, 0.5, "pass"),
    ],
)
def test_frames_are_judged_by_saturation_and_by_the_motion_that_the_sequence_allows(
    gate, share, most_px, verdict
):
    measurement, limits = Measurement(None, None, {"motion_px": 0.2}), {"max_motion_px": most_px}
    gates = frame_gates(replace(TAKEN, saturated_share=share), Gates(0, 200.0, True, limits), measurement)
    assert {judged.name: judged.verdict for judged in gates}[gate] == verdict


def test_an_incomplete_series_of_frames_is_rejected():
    (reason,) = frame_rejection_reasons(replace(TAKEN, complete=False))
    assert "fewer frames" in reason
    assert frame_rejection_reasons(TAKEN) == []


def test_frames_without_a_target_and_other_files_report_a_fault(tmp_path):
    write_frames(tmp_path / "dark.tif", [np.zeros((240, 320), np.uint8)] * 2)
    measurement = measure_frames(tmp_path / "dark.tif", name="dark", target=StarTarget())
    assert (measurement.view, measurement.facts["image"]["pictures"]) == (None, 2)
    assert measurement.fault
    (tmp_path / "bad.tif").write_bytes(b"hello")
    fault = measure_frames(tmp_path / "bad.tif", name="bad", target=StarTarget()).fault
    assert "no images" in fault
    assert str(tmp_path) not in fault  # whoever shows it names the file
