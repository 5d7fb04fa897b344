"""The contract tests of a frame camera: what every driver of a frame camera must do, with any camera."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from bench.plugin_tests.cameras import AnyCameraContract, Interrupted, InterruptingClock, SimulatedCamera
from bench.plugin_tests.rig import fails_in_time
from drivers.camera.frames import FrameCamera, FrameSettings, read_frames
from drivers.errors import CameraLost, CameraSettingRefused, DriverError, RecordingFailed

_MANY = 5000
"""Number of frames of a capture that something is to end early."""
_AT_WORK_S = 0.5
"""After this time a capture is at work, s."""
_LONGEST_END_S = 15.0
"""Longest time until a stopped capture ends, s."""


class FrameCameraContract(AnyCameraContract):
    """Derive from this class, name it ``Test...``, and give ``section`` and ``connected``.

    The frames of the simulated camera have the noise of a sensor.

    Attributes
    ----------
    settings
        Exposure and gain that the camera can set; empty if it can set none.
    impossible_settings
        Exposure and gain that it cannot set; empty if it takes all.
    """

    settings: ClassVar[Mapping[str, float]] = {}
    impossible_settings: ClassVar[Mapping[str, float]] = {}

    def test_settings_are_read_back(self, camera: FrameCamera) -> None:
        """Settings are read back, also a second time."""
        for _ in range(2):
            wanted = FrameSettings(**self.settings)
            got = camera.apply(wanted)
            for name, value in self.settings.items():
                assert getattr(got, name) == pytest.approx(value, rel=0.02)

    def test_an_impossible_setting_is_refused(self, camera: FrameCamera, tmp_path: Path) -> None:
        """An impossible setting is refused, and the camera still works."""
        if not self.impossible_settings:
            pytest.skip("this camera takes all settings")
        wanted = FrameSettings(**self.impossible_settings)
        fails_in_time(lambda: camera.apply(wanted), CameraSettingRefused)
        assert camera.capture(tmp_path / "one.tif", 1).complete

    def test_the_facts_of_a_capture_are_those_of_its_file(self, camera: FrameCamera, tmp_path: Path) -> None:
        """The facts of a capture are those of its file, for one frame and for several."""
        who = camera.identify()
        for count in (1, 4):
            path = tmp_path / f"{count}.tif"
            facts = camera.capture(path, count)
            frames = read_frames(path)
            assert facts.complete
            assert frames.shape == (count, facts.height, facts.width) == (count, who.height, who.width)
            assert (facts.serial, facts.model, facts.frames) == (who.serial, who.model, count)
            assert facts.bits == 8 * frames.dtype.itemsize
            assert facts.bytes == path.stat().st_size
            saturated = (frames == np.iinfo(frames.dtype).max).mean()
            assert facts.saturated_share == pytest.approx(saturated, abs=1e-6)

    def test_no_frame_comes_twice(self, camera: FrameCamera, tmp_path: Path) -> None:
        """No frame of a capture stands in the next one, and all frames of a capture differ by their noise."""
        for name in ("one.tif", "two.tif"):
            camera.capture(tmp_path / name, 3)
        frames = [*read_frames(tmp_path / "one.tif"), *read_frames(tmp_path / "two.tif")]
        assert len({frame.tobytes() for frame in frames}) == len(frames)

    def test_no_file_is_ever_overwritten(self, camera: FrameCamera, tmp_path: Path) -> None:
        """No file is ever overwritten, and a missing folder is an error."""
        (tmp_path / "one.tif").write_bytes(b"evidence")
        fails_in_time(lambda: camera.capture(tmp_path / "one.tif", 1), RecordingFailed)
        assert (tmp_path / "one.tif").read_bytes() == b"evidence"
        fails_in_time(lambda: camera.capture(tmp_path / "none" / "one.tif", 1), RecordingFailed)
        assert camera.capture(tmp_path / "two.tif", 1).complete

    @pytest.mark.parametrize("frames", [0, -1])
    def test_no_frame_at_all_is_refused(self, camera: FrameCamera, tmp_path: Path, frames: int) -> None:
        """No frame at all is refused, and leaves no file."""
        with pytest.raises((DriverError, ValueError)):
            camera.capture(tmp_path / "one.tif", frames)
        assert not list(tmp_path.iterdir())

    def test_a_stop_from_another_thread_ends_a_capture(self, camera: FrameCamera, tmp_path: Path) -> None:
        """A stop from another thread ends a capture, whose file can be read; the next one is complete."""
        stopper = threading.Timer(_AT_WORK_S, camera.stop)
        stopper.start()
        began_s = time.monotonic()
        with suppress(RecordingFailed):
            facts = camera.capture(tmp_path / "one.tif", _MANY)
            assert not facts.complete
            assert len(read_frames(tmp_path / "one.tif")) == facts.frames
        assert time.monotonic() - began_s < _LONGEST_END_S
        stopper.join()
        assert camera.capture(tmp_path / "two.tif", 1).complete

    def test_an_interrupted_capture_leaves_no_file(
        self, camera: FrameCamera, clock: InterruptingClock, tmp_path: Path
    ) -> None:
        """An interrupted capture leaves no file, because frames are quickly taken again; the camera works."""
        clock.interrupts_at_s = clock.monotonic() + _AT_WORK_S
        with pytest.raises(Interrupted):
            camera.capture(tmp_path / "one.tif", _MANY)
        clock.interrupts_at_s = float("inf")
        assert not list(tmp_path.iterdir())
        assert camera.capture(tmp_path / "one.tif", 1).complete

    def test_a_pulled_cable_is_a_lost_camera(
        self, camera: FrameCamera, simulated: SimulatedCamera, tmp_path: Path
    ) -> None:
        """A pulled cable is a lost camera in bounded time, also for the next capture; a stop does no harm."""
        puller = threading.Timer(_AT_WORK_S, simulated.unplug)
        puller.start()
        fails_in_time(lambda: camera.capture(tmp_path / "one.tif", _MANY), CameraLost)
        puller.join()
        camera.stop()
        fails_in_time(lambda: camera.capture(tmp_path / "two.tif", 1), CameraLost)
        assert not list(tmp_path.iterdir())

    def test_a_closed_camera_is_an_error_and_is_opened_again(
        self, simulated: SimulatedCamera, clock: InterruptingClock, tmp_path: Path
    ) -> None:
        """A closed camera is an error of the driver, and is opened again."""
        for name in ("one.tif", "two.tif"):
            camera = self._opened(simulated, clock)
            assert camera.capture(tmp_path / name, 1).complete
            camera.close()
            camera.close()
            fails_in_time(camera.identify)
            fails_in_time(lambda: camera.capture(tmp_path / "closed.tif", 1))  # noqa: B023 - called at once
