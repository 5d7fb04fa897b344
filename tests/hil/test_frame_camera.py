"""Frame cameras: the same run as with an event camera, on pictures; and the simulated one as OpenCV sees it."""

import json
import socket
import threading
import time
from contextlib import ExitStack

import numpy as np
import pytest
from running import called, journal, results, starbench
from shared_folder import shared_folder

from bench.measure.measure_frames import frame_gates, measure_frames
from bench.stations.station import SHIPPED_STATIONS
from calib.target import StarTarget
from drivers.camera import frame_cameras
from drivers.camera.frame_cameras import OpenCvFrameCamera
from drivers.camera.frames import read_frames, write_frames
from drivers.clock import SystemClock
from drivers.errors import CameraLost, CameraNotFound, RecordingFailed
from sequences.script import Gates
from simulators.cameras.frame_camera import SimulatedFrameCamera
from simulators.cameras.streaming import FRAME_CAMERA_FAULTS
from simulators.world.truth import CameraTruth, Truth
from simulators.world.world import AxisMotion, LightState, World

STEADY = LightState(low_v=5.0, high_v=5.0, output=True)


SMALL = {"width": 640, "height": 360, "fx": 1672.0, "fy": 1672.0, "cx": 320.0, "cy": 180.0}
"""The same field of view as the camera of the bench, with a quarter of its pixels."""


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    def make(folder):
        text = (SHIPPED_STATIONS / "simulated_frames.yaml").read_text(encoding="utf-8")
        expected = "expected:\n  image_size: [640, 360]\n  focal_px: 1672"
        text = text.replace("simulation:\n", f"simulation:\n  camera: {json.dumps(SMALL)}\n")
        station = folder / "small.yaml"
        station.write_text(text.replace("expected:\n  focal_px: 3300", expected), encoding="utf-8")
        words = ("run", "three_pose", "-s", station, "--seed", 7, "-o", folder / "run")
        called(*words, home=folder / "home")

    return shared_folder(tmp_path_factory, "frames", make) / "run"


DISTORTION = {"k1", "k2", "k3"}


def errors(run_results):
    """Sizes of the errors in sigmas, by name."""
    return {row["name"]: abs(row["error_sigmas"]) for row in run_results["comparison"]}


def test_a_run_with_a_frame_camera_ends_with_focal_length_and_principal_point_within_their_uncertainty(
    finished,
):
    run_results = results(finished)
    assert run_results["run"]["camera"] == "frame"
    assert run_results["calibration"]["converged"]
    k = run_results["calibration"]["coverage_factor"]
    assert max(size for name, size in errors(run_results).items() if name not in DISTORTION) <= k
    assert run_results["passport"]["number"] == "SIM-2026-01"
    assert run_results["calibration"]["rms_px"] < 0.2  # most of it is the collimator's


def test_the_pictures_are_the_evidence_and_the_light_burnt_steadily(finished):
    captures = sorted(path.name for path in (finished / "captures").iterdir())
    assert captures == [f"pose-{n:03d}-attempt-1.tif" for n in (1, 2, 3)]
    assert read_frames(finished / "captures" / captures[0]).shape == (8, 360, 640)
    stored = [line for line in journal(finished) if line["event"] == "capture_stored"]
    assert {capture["light"]["waveform"] for capture in stored} == {"steady"}
    assert {capture["facts"]["frames"] for capture in stored} == {8}


def test_the_report_speaks_of_pictures_and_leaves_out_what_only_events_have(finished):
    report = (finished / "report.html").read_text()
    assert "frame camera" in report
    assert "Pictures</th>" in report
    page = report.partition("<main>")[2]
    assert page
    for word in ("Mev/s", "Triggers", "Flicker, Hz", "vent image", "events", "biases", "duty"):
        assert word not in page, word


@pytest.mark.slow
def test_its_results_follow_from_its_pictures(finished, home):
    called("verify", finished, "--again", home=finished.with_name("home"))
    again = starbench("calibrate", finished, "--json", home=home)
    assert json.loads(again.stdout)["camera"] == results(finished)["calibration"]["camera"]


@pytest.mark.slow
def test_pictures_of_a_run_played_again_give_the_same_camera(finished, home, tmp_path):
    """A folder of pictures as the camera, on the simulated stage: eight a pose, in their order."""
    (tmp_path / "pictures").mkdir()
    taken = [frame for path in sorted((finished / "captures").iterdir()) for frame in read_frames(path)]
    for number, frame in enumerate(taken):
        write_frames(tmp_path / "pictures" / f"{number:03d}.tif", [frame])
    station = (finished / "station.yaml").read_text()
    camera = "driver: opencv\n  source: sim:frame-camera"
    assert camera in station
    played = station.replace(camera, f"driver: pictures\n  path: {tmp_path / 'pictures'}")
    (tmp_path / "played.yaml").write_text(played)
    folder = tmp_path / "again"
    starbench("run", "three_pose", "-s", tmp_path / "played.yaml", "-o", folder, home=home)
    assert results(folder)["calibration"]["camera"] == results(finished)["calibration"]["camera"]
    assert results(folder)["run"]["simulated"]


# ------------------------------------------------------------- the simulated camera, as OpenCV sees it


@pytest.fixture
def world():
    world = World(Truth(camera=CameraTruth(**SMALL)), seed=3, clock=time.monotonic)
    world.set_light(STEADY)
    return world


@pytest.fixture
def simulated(world):
    camera = SimulatedFrameCamera(world)
    camera.start()
    yield camera
    camera.close()


@pytest.fixture
def camera(simulated):
    camera = OpenCvFrameCamera.open(simulated.address, clock=SystemClock())
    yield camera
    camera.close()


def test_every_capture_shows_the_pose_and_light_of_its_own_time(world, camera, tmp_path):
    camera.capture(tmp_path / "bright.tif", 1)
    world.set_light(LightState(output=False))
    camera.capture(tmp_path / "dark.tif", 1)
    world.set_light(STEADY)
    world.set_axis("pan", AxisMotion.resting(5.0, 32_000))
    camera.capture(tmp_path / "turned.tif", 1)
    bright, dark, turned = (read_frames(tmp_path / f"{n}.tif")[0] for n in ("bright", "dark", "turned"))
    assert bright.mean() > 30
    assert dark.max() < 10
    shift = np.abs(turned.astype(int) - bright).mean()
    assert shift > 10


def test_a_camera_that_turns_while_it_takes_pictures_is_refused_by_its_own_stars(world, camera, tmp_path):
    still = camera.capture(tmp_path / "still.tif", 2)
    world.set_axis("pan", AxisMotion.resting(0.02, 128))
    camera.capture(tmp_path / "turned.tif", 2)
    frames = [*read_frames(tmp_path / "still.tif"), *read_frames(tmp_path / "turned.tif")]
    write_frames(tmp_path / "both.tif", frames)
    measurement = measure_frames(tmp_path / "both.tif", name="pose", target=StarTarget())
    gates = frame_gates(still, Gates(40, 200.0, True), measurement)
    assert {gate.name: gate.verdict for gate in gates}["stars moved"] == "fail"


@pytest.mark.parametrize("frames", [None, 0, 2], ids=["says nothing", "no picture", "two pictures"])
def test_a_network_camera_that_falls_silent_is_given_up_within_its_deadline(tmp_path, monkeypatch, frames):
    monkeypatch.setattr(frame_cameras, "START_S", 1.0)
    monkeypatch.setattr(frame_cameras, "SILENCE_S", 1.0)
    sent = b"" if frames is None else b"YUV4MPEG2 W64 H48 F25:1 Ip A1:1 Cmono\n"
    sent += (b"FRAME\n" + bytes(64 * 48)) * (frames or 0)
    with ExitStack() as links, socket.create_server(("127.0.0.1", 0)) as server:

        def serve():
            while True:
                try:
                    link = links.enter_context(server.accept()[0])
                except OSError:
                    return
                link.sendall(sent)

        threading.Thread(target=serve, daemon=True).start()
        began = time.monotonic()
        with pytest.raises((CameraLost, CameraNotFound)):
            OpenCvFrameCamera.open(f"tcp://127.0.0.1:{server.getsockname()[1]}", clock=SystemClock()).capture(
                tmp_path / "pose.tif", 8
            )
        assert time.monotonic() - began < 20.0
        server.shutdown(socket.SHUT_RDWR)
    assert not list(tmp_path.iterdir())


def test_a_source_that_is_not_there_is_told_in_our_words_alone(capfd):
    for name in ("tcp://127.0.0.1:1", "/dev/video77"):
        with pytest.raises(CameraNotFound, match=r"video (source|device)"):
            OpenCvFrameCamera.open(name, clock=SystemClock())
    assert capfd.readouterr() == ("", "")


FAULTS = {
    "unplug": (CameraLost, "video source"),
    "silence": (CameraLost, "video source"),
    "frozen": (RecordingFailed, "frozen"),
}


@pytest.mark.parametrize("fault", [name for name in FRAME_CAMERA_FAULTS if name != "mend"])
def test_each_fault_of_the_camera_is_noticed_and_over_when_it_is_mended(
    simulated, camera, tmp_path, monkeypatch, fault
):
    camera.capture(tmp_path / "before.tif", 2)
    simulated.inject_fault(fault)
    kind, words = FAULTS[fault]
    began = time.monotonic()
    with (
        monkeypatch.context() as impatient
    ):  # where nothing is wrong, a busy computer may take longer than this
        impatient.setattr(frame_cameras, "SILENCE_S", 1.0)
        with pytest.raises(kind, match=words):
            camera.capture(tmp_path / "during.tif", 2)
    assert time.monotonic() - began < 20.0
    simulated.inject_fault("mend")
    camera.capture(tmp_path / "after.tif", 2)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["after.tif", "before.tif"]
