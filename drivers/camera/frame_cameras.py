"""Driver of frame cameras: every video source that OpenCV opens."""

from __future__ import annotations

import hashlib
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from drivers.camera import CameraIdentity
from drivers.camera.camera_lock import CameraLock
from drivers.camera.frames import Frame, FrameFacts, FrameSettings, capture_frames, to_grey
from drivers.camera.video_devices import SYSTEM, device_path, usb_serial
from drivers.clock import Clock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    RecordingFailed,
    WrongDevice,
)

STALE_FRAMES: Final = 5
"""Number of old frames that a video device may hand out: four in its buffers, and the one that is being exposed."""

START_S: Final = 60.0
"""Longest time until a network camera's first frame after it is opened, s."""

SILENCE_S: Final = 10.0
"""Longest time without a frame later, s; for a video device of Linux, OpenCV waits as long."""

_MANUAL_EXPOSURE: Final = 1.0
"""V4L2's value of manual exposure."""


class OpenCvFrameCamera:
    """A ``FrameCamera`` on a video source: a video device, a network camera's URL, a video or numbered files.

    The computer chooses which device has which number, and OpenCV has no serial numbers. So a station file should
    name a device by its id (``/dev/v4l/by-id/...``), and its serial number as USB states it. A network camera states
    none.

    serial: The serial number that the camera must have; empty accepts any.
    clock: Its ``sleep`` is called before each frame.
    shown_as: What messages and the camera's identity say in place of ``name``, where that is secret; empty
      for the name.
    """

    def __init__(
        self, name: str, *, serial: str = "", clock: Clock, system: Path = SYSTEM, shown_as: str = ""
    ) -> None:
        self._name = name
        self._shown_as = shown_as or name
        self._serial = serial
        self._clock = clock
        self._system = system
        self._device = device_path(name)
        self._network = "://" in name
        self._stop_asked = threading.Event()
        self._source: Any = None
        self._last: Frame | None = None
        self._lock: CameraLock | None = None
        if self._is_live:
            secret = f"video source {hashlib.sha256(name.encode()).hexdigest()[:16]}" if shown_as else name
            self._lock = CameraLock(str(self._device.resolve() if self._device else secret))
        try:
            self._check_serial()
            self._source = self._opened(START_S)
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(
        cls, source: str, *, serial: str = "", clock: Clock, system: Path = SYSTEM, shown_as: str = ""
    ) -> OpenCvFrameCamera:
        """Open a video source.

        serial: The serial number that the camera must have; empty accepts any.
        clock: Its ``sleep`` is called before each frame.
        shown_as: What is printed in place of a source that is secret.
        Raises CameraNotFound: If OpenCV cannot open the source.
        Raises CameraBusy: If another process has locked it.
        Raises WrongDevice: If a serial number is given and the camera has another one, or none.
        """
        return cls(source, serial=serial, clock=clock, system=system, shown_as=shown_as)

    def identify(self) -> CameraIdentity:
        """Return the source's name, serial number and frame size.

        Returns: The model is "OpenCV" and the name of the source.
        Raises CameraLost: If the video device does not exist any more.
        Raises WrongDevice: If it is another camera by now.
        """
        self._require_open()
        serial = self._check_serial()
        width = int(self._source.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._source.get(cv2.CAP_PROP_FRAME_HEIGHT))
        return CameraIdentity("", f"OpenCV {self._shown_as}", "", serial, "", width, height)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Set exposure and gain in the driver's own units, read them back, and switch autofocus off.

        Returns: The same settings; they were read back to within 1 %.
        Raises CameraSettingRefused: If a setting reads back otherwise, or the autofocus stays on.
        """
        self._require_open()
        if self._device is not None:
            self._source.set(cv2.CAP_PROP_AUTOFOCUS, 0.0)
            if self._source.get(cv2.CAP_PROP_AUTOFOCUS) > 0:
                raise self._refused("the autofocus stays on, and every focus has another focal length")
        wanted = {cv2.CAP_PROP_EXPOSURE: settings.exposure, cv2.CAP_PROP_GAIN: settings.gain}
        if settings.exposure is not None:
            self._source.set(cv2.CAP_PROP_AUTO_EXPOSURE, _MANUAL_EXPOSURE)
        for what, value in wanted.items():
            if value is not None:
                name = "exposure" if what == cv2.CAP_PROP_EXPOSURE else "gain"
                taken = self._source.set(what, value)
                held = float(self._source.get(what))
                if not taken or abs(held - value) > 0.01 * abs(value):
                    raise self._refused(f"{name} was set to {value:g}, but reads back {held:g}")
        return settings

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """Take frames; see `FrameCamera.capture`. Frames buffered from before are dropped.

        path: The file to make; it must not exist.
        Raises RecordingFailed: If the camera repeats a frame, or the frames cannot be written.
        Raises CameraLost: If the camera sends no frame.
        """
        self._stop_asked.clear()
        self._require_open()
        if self._network:
            # Any number of frames may be buffered on the way from a network camera: a new connection has none of them.
            self._source.release()
            try:
                self._source = self._opened(SILENCE_S)
            except CameraNotFound as error:
                raise CameraLost(error.what, where=error.where, remedy=error.remedy) from error
        for _ in range(STALE_FRAMES if self._device is not None else 0):
            self._clock.sleep(0.0)
            if not self._source.grab():
                raise self._silent()
        frozen_check = _FrozenCheck(self._last, frames, where=self._where)
        facts = capture_frames(
            path,
            frames,
            lambda: frozen_check.check(self._next()) if self._is_live else self._next(),
            self.identify(),
            clock=self._clock,
            stop_asked=self._stop_asked,
        )
        self._last = frozen_check.latest
        return facts

    def stop(self) -> None:
        """See `FrameCamera.stop`."""
        self._stop_asked.set()

    def close(self) -> None:
        """See `FrameCamera.close`."""
        if self._source is not None:
            self._source.release()
            self._source = None
        if self._lock is not None:
            self._lock.release()

    # ------------------------------------------------------------- internals

    def _require_open(self) -> None:
        if self._source is None:
            raise CameraError(
                "The camera is closed.", where=self._where, remedy="Open it again; then resume the run."
            )

    @property
    def _is_live(self) -> bool:
        return self._device is not None or self._network

    @property
    def _where(self) -> str:
        return f"video source {self._shown_as}"

    def _opened(self, within_s: float) -> Any:
        """Open the source. Raises CameraNotFound."""
        with _opencv_silenced():
            opened = self._capture(within_s)
        if not opened.isOpened():
            opened.release()
            raise CameraNotFound(
                f"OpenCV cannot open the video source {self._shown_as!r}.",
                remedy="Check the number, path or URL, the cable, and that no other program uses the camera.",
            )
        return opened

    def _capture(self, within_s: float) -> Any:
        if self._network:
            waits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, int(1e3 * within_s)]
            waits += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, int(1e3 * SILENCE_S)]
            return cv2.VideoCapture(self._name, cv2.CAP_FFMPEG, waits)
        if self._device is None:
            return cv2.VideoCapture(self._name)
        if sys.platform == "linux":
            return cv2.VideoCapture(str(self._device), cv2.CAP_V4L2)
        return cv2.VideoCapture(int(self._name))

    def _check_serial(self) -> str:
        found = ""
        if self._device is not None:
            if self._system.is_dir() and not (self._system / self._device.name).exists():
                gone = CameraNotFound if self._source is None else CameraLost
                raise gone(
                    "There is no such video device.",
                    where=self._where,
                    remedy="Plug the camera in; `starbench devices` lists the connected cameras.",
                )
            found = usb_serial(self._device, self._system)
        if self._serial and found != self._serial:
            answer = f"camera {found}" if found else "a camera without a serial number"
            raise WrongDevice(
                f"This is {answer}, not {self._serial}.",
                where=self._where,
                remedy="Plug in the right camera, or correct the source or the serial number in the station file"
                " (without a serial number, any camera is accepted).",
            )
        return found

    def _refused(self, why: str) -> CameraSettingRefused:
        return CameraSettingRefused(
            f"{why[0].upper()}{why[1:]}.",
            where=self._where,
            remedy="Make this setting with the camera's own program and leave it out of the station file, or use "
            "another camera.",
        )

    def _next(self) -> Frame:
        got, image = self._source.read()
        if not got:
            raise self._silent()
        return to_grey(image, where=self._where)

    def _silent(self) -> CameraLost:
        return CameraLost(
            "The camera sends no more frames.",
            where=self._where,
            remedy="Check the camera's cable and power; a video file may have ended.",
        )


class _FrozenCheck:
    """Check that a live camera does not repeat a frame: the noise of a sensor makes every frame different.

    before: The last frame of the previous capture.
    """

    def __init__(self, before: Frame | None, frames: int, *, where: str) -> None:
        self.latest: Frame | None = None
        self._before = before
        self._frames = frames
        self._repeats = 0
        self._where = where

    def check(self, frame: Frame) -> Frame:
        """Return the frame. Raises RecordingFailed for the previous capture's last frame, or if all are the same."""
        if self._before is not None and np.array_equal(frame, self._before):
            raise self._frozen("The camera sent the last frame of the previous capture again")
        self._repeats += self.latest is not None and np.array_equal(frame, self.latest)
        self.latest = frame
        if 0 < self._repeats == self._frames - 1:
            raise self._frozen("All frames are identical to the last bit")
        return frame

    def _frozen(self, what: str) -> RecordingFailed:
        return RecordingFailed(
            f"{what}: the camera has frozen, or sends buffered frames.",
            where=self._where,
            remedy="Restart the camera; choose exposure and compression that leave the sensor's noise visible.",
        )


@contextmanager
def _opencv_silenced() -> Iterator[None]:
    """Keep OpenCV and FFmpeg from writing to the terminal what the error states anyway."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read by OpenCV when it first uses FFmpeg
    logging = cv2.utils.logging
    before = logging.setLogLevel(logging.LOG_LEVEL_ERROR)
    try:
        yield
    finally:
        logging.setLogLevel(before)
