"""The contract tests of an event camera: what every driver of an event camera must do, with any camera."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
import pytest

from bench.extras.plugin_tests.rig import Connected, ConnectedContract, fails_in_time, station_of
from bench.extras.plugin_tests.stages import ContractClock
from drivers.camera import CameraSettings, EventCamera
from drivers.camera.frames import FrameCamera, FrameSettings, read_frames
from drivers.camera.raw_file import RawFile
from drivers.errors import CameraLost, CameraSettingRefused, DriverError, RecordingFailed

_AT_WORK_S = 0.5
"""After this time a recording is at work, s."""
_LONGEST_END_S = 15.0
"""Longest time until a stopped recording ends, s."""


class SimulatedCamera(Connected, Protocol):
    """A simulated camera that a driver can reach."""


class Interrupted(Exception):
    """What the clock of a run raises if the run is to end."""


class InterruptingClock(ContractClock):
    """A clock that interrupts every wait from some time on."""

    def __init__(self) -> None:
        super().__init__()
        self.interrupts_at_s = float("inf")

    def sleep(self, seconds: float) -> None:
        """See `Clock.sleep`."""
        ends_s = self.monotonic() + seconds
        while True:
            if self.monotonic() > self.interrupts_at_s:
                raise Interrupted
            if self.monotonic() >= ends_s:
                return
            super().sleep(min(ends_s - self.monotonic(), 0.05))


class AnyCameraContract(ConnectedContract):
    """What the contracts of event cameras and of frame cameras share.

    Attributes
    ----------
    other_serial
        A serial number that the simulated camera does not have.
    """

    other_serial: ClassVar[str]
    _ending: ClassVar[str]
    _short: ClassVar[float]
    """How much a test takes that is to be complete: s of a recording, or frames."""
    _long: ClassVar[float]
    """How much a test asks for where something ends the recording early."""

    @pytest.fixture
    def clock(self) -> InterruptingClock:
        """A clock that can interrupt waits."""
        return InterruptingClock()

    @pytest.fixture
    def camera(self, simulated: SimulatedCamera, clock: InterruptingClock) -> Iterator[Any]:
        """The open camera."""
        with closing(self._opened(simulated, clock)) as camera:
            yield camera

    def _opened(self, simulated: SimulatedCamera, clock: ContractClock, **changes: object) -> Any:
        station = station_of("camera", self.section, simulated.address, changes)
        any_clock: Any = clock
        return station.camera.open_device(str, clock=any_clock)

    def _prepare(self, camera: Any) -> None:
        """Do what a run does before it takes something."""

    def _take(self, camera: Any, path: Path, amount: float) -> Any:
        """Take s of a recording, or frames, into a file; return its facts."""
        raise NotImplementedError

    def _check_file(self, path: Path, facts: Any) -> None:
        """Check that a file can be read to its end, and holds what the facts state."""
        raise NotImplementedError

    def _check_left(self, folder: Path) -> None:
        """Check what a recording left that was ended by an error."""
        raise NotImplementedError

    def test_it_says_who_it_is(self, camera: Any) -> None:
        """It says who it is, each time alike."""
        who = camera.identify()
        assert who == camera.identify()
        assert who.serial == str(self.section.get("serial", who.serial))
        assert min(who.width, who.height) > 0

    def test_another_serial_number_is_refused(self, simulated: SimulatedCamera, clock: ContractClock) -> None:
        """Another serial number is refused."""
        fails_in_time(lambda: self._opened(simulated, clock, serial=self.other_serial))

    def test_no_file_is_ever_overwritten(self, camera: Any, tmp_path: Path) -> None:
        """No file is ever overwritten, and a missing folder is an error."""
        self._prepare(camera)
        there = tmp_path / f"one{self._ending}"
        there.write_bytes(b"evidence")
        for path in (there, tmp_path / "none" / there.name):
            fails_in_time(lambda path=path: self._take(camera, path, self._short), RecordingFailed)  # type: ignore[misc]
        assert there.read_bytes() == b"evidence"
        assert self._take(camera, tmp_path / f"two{self._ending}", self._short).complete

    @pytest.mark.parametrize("amount", [0, -1])
    def test_nothing_at_all_is_refused(self, camera: Any, tmp_path: Path, amount: int) -> None:
        """No time and no frame at all are refused, and leave no file."""
        self._prepare(camera)
        with pytest.raises((DriverError, ValueError)):
            self._take(camera, tmp_path / f"one{self._ending}", amount)
        assert not list(tmp_path.iterdir())

    def test_a_stop_from_another_thread_ends_a_recording(self, camera: Any, tmp_path: Path) -> None:
        """A stop from another thread ends a recording, whose file can be read; the next one is complete."""
        self._prepare(camera)
        path = tmp_path / f"one{self._ending}"
        stopper = threading.Timer(_AT_WORK_S, camera.stop)
        stopper.start()
        began_s = time.monotonic()
        with suppress(RecordingFailed):
            facts = self._take(camera, path, self._long)
            assert not facts.complete
            self._check_file(path, facts)
        assert time.monotonic() - began_s < _LONGEST_END_S
        stopper.join()
        assert self._take(camera, tmp_path / f"two{self._ending}", self._short).complete

    def test_an_interrupted_recording_leaves_nothing_unreadable(
        self, camera: Any, clock: InterruptingClock, tmp_path: Path
    ) -> None:
        """An interrupted recording leaves a file of events that can be read, or no frames; the camera works."""
        self._prepare(camera)
        clock.interrupts_at_s = clock.monotonic() + _AT_WORK_S
        with pytest.raises(Interrupted):
            self._take(camera, tmp_path / f"one{self._ending}", self._long)
        clock.interrupts_at_s = float("inf")
        self._check_left(tmp_path)
        assert self._take(camera, tmp_path / f"two{self._ending}", self._short).complete

    def test_a_pulled_cable_is_a_lost_camera(
        self, camera: Any, simulated: SimulatedCamera, tmp_path: Path
    ) -> None:
        """A pulled cable is a lost camera in bounded time, also for the next recording; a stop does no harm."""
        self._prepare(camera)
        puller = threading.Timer(_AT_WORK_S, simulated.unplug)
        puller.start()
        fails_in_time(lambda: self._take(camera, tmp_path / f"one{self._ending}", self._long), CameraLost)
        puller.join()
        self._check_left(tmp_path)
        camera.stop()
        fails_in_time(lambda: self._take(camera, tmp_path / f"two{self._ending}", self._short))

    def test_a_closed_camera_is_an_error_and_is_opened_again(
        self, simulated: SimulatedCamera, clock: ContractClock, tmp_path: Path
    ) -> None:
        """A closed camera is an error of the driver, and is opened again."""
        for name in ("one", "two"):
            camera = self._opened(simulated, clock)
            self._prepare(camera)
            assert self._take(camera, tmp_path / f"{name}{self._ending}", self._short).complete
            camera.close()
            camera.close()
            fails_in_time(lambda camera=camera: self._take(camera, tmp_path / "closed", self._short))  # type: ignore[misc]


class CameraContract(AnyCameraContract):
    """Derive from this class, name it ``Test...``, and give ``section`` and ``connected``.

    The trigger input of the simulated camera gets edges.

    Attributes
    ----------
    biases
        Offsets of biases that the camera can set.
    impossible_biases
        Offsets that it cannot set; empty if it takes all.
    """

    biases: ClassVar[Mapping[str, int]] = {}
    impossible_biases: ClassVar[Mapping[str, int]] = {}
    _ending, _short, _long = ".raw", 0.05, 30.0

    def _prepare(self, camera: Any) -> None:
        camera.apply(CameraSettings())

    def _take(self, camera: Any, path: Path, amount: float) -> Any:
        return camera.record(path, float(amount))

    def _check_file(self, path: Path, facts: Any) -> None:
        assert RawFile.open(path).scan().events == facts.events

    def _check_left(self, folder: Path) -> None:
        """What was recorded is kept, under its own name or another, and can be read to its end."""
        (left,) = folder.iterdir()
        assert RawFile.open(left).scan().events >= 0

    def test_settings_are_read_back_and_all_filters_are_off(self, camera: EventCamera) -> None:
        """Settings are read back, and all filters are off."""
        for biases in (self.biases, {}, self.biases):
            got = camera.apply(CameraSettings(biases))
            assert got.trigger_in
            assert got.roi is None
            assert {name: value for name, value in got.biases.items() if value} == dict(biases)
            assert not any(camera.filters().values())

    def test_an_impossible_bias_is_refused(self, camera: EventCamera) -> None:
        """An impossible bias is refused, and the camera still works."""
        if not self.impossible_biases:
            pytest.skip("this camera takes all biases")
        fails_in_time(lambda: camera.apply(CameraSettings(self.impossible_biases)), CameraSettingRefused)
        camera.apply(CameraSettings())

    def test_the_facts_of_a_recording_are_those_of_its_file(
        self, camera: EventCamera, tmp_path: Path
    ) -> None:
        """The facts of a recording are those of its file, twice."""
        camera.apply(CameraSettings(self.biases))
        who = camera.identify()
        for name in ("one.raw", "two.raw"):
            facts = camera.record(tmp_path / name, 0.1)
            file = RawFile.open(tmp_path / name)
            statistics = file.scan()
            assert facts.complete
            assert (facts.serial, facts.width, facts.height) == (who.serial, who.width, who.height)
            assert (facts.events, facts.triggers) == (statistics.events, statistics.triggers)
            assert facts.bytes == (tmp_path / name).stat().st_size
            assert statistics.triggers > 0, "the simulated camera needs edges at its trigger input"
            assert 0.1 <= facts.duration_s < 1.0
            assert facts.duration_s == pytest.approx(statistics.duration_s, abs=1e-3)
            assert not any(facts.filters.values())
            for bias, value in self.biases.items():
                assert facts.biases.get(bias, value) == value


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
    _ending, _short, _long = ".tif", 1, 5000

    def _take(self, camera: Any, path: Path, amount: float) -> Any:
        return camera.capture(path, int(amount))

    def _check_file(self, path: Path, facts: Any) -> None:
        assert len(read_frames(path)) == facts.frames

    def _check_left(self, folder: Path) -> None:
        """No file: frames are quickly taken again."""
        assert not list(folder.iterdir())

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
