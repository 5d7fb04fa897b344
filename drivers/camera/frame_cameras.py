"""Frame cameras: whatever OpenCV opens as a video source, and folders of pictures taken before."""

from __future__ import annotations

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
from drivers.camera.frames import Frame, FrameFacts, FrameSettings, capture_frames, read_frames, to_grey
from drivers.camera.video_devices import SYSTEM, device_path, usb_serial
from drivers.clock import Clock
from drivers.errors import CameraLost, CameraNotFound, CameraSettingRefused, RecordingFailed, WrongDevice

IMAGE_SUFFIXES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")

STALE_FRAMES: Final = 5
"""Pictures of the past that a video device may hand out: four in its buffers, one being exposed as it is asked."""

START_S: Final = 60.0
"""How long a network camera may take until its first picture, when it is opened."""

SILENCE_S: Final = 10.0
"""How long one that has sent pictures before may send nothing; OpenCV waits as long for a video device of Linux."""

_MANUAL_EXPOSURE: Final = 1.0
"""V4L2's word for it."""


class FolderFrameCamera:
    """A ``FrameCamera`` that hands on the pictures of a folder: files in the order of their names, each page by page.

    Parameters
    ----------
    files
        The pictures.
    serial
        What the station file says of the camera that took them: pictures do not tell.
    clock
        Passed through before each.
    """

    def __init__(self, files: list[Path], *, serial: str = "", clock: Clock) -> None:
        self._files = files
        self._serial = serial
        self._clock = clock
        self._stop_asked = threading.Event()
        self._taken = 0
        self._coming = iter(files)
        self._pages: list[Frame] = []
        first = read_frames(files[0])
        self._size = first.shape[2], first.shape[1]

    @classmethod
    def open(cls, folder: Path | str, *, serial: str = "", clock: Clock) -> FolderFrameCamera:
        """Find the pictures. Raises CameraNotFound when there are none, NotARecording for one that is none."""
        folder = Path(folder)
        files = sorted(path for path in folder.glob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise CameraNotFound(
                "No pictures are in this folder.",
                where=str(folder),
                remedy=f"Name a folder with {', '.join(IMAGE_SUFFIXES)}.",
            )
        return cls(files, serial=serial, clock=clock)

    def identify(self) -> CameraIdentity:
        """Pictures do not say who took them: only their size is known."""
        return CameraIdentity("", "pictures", "", self._serial, "", *self._size)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Take settings that change nothing. Raises CameraSettingRefused for one that would have to."""
        if settings != FrameSettings():
            raise CameraSettingRefused(
                "Exposure and gain of pictures cannot be changed any more.",
                where=str(self._files[0].parent),
                remedy="Leave them out of the station file.",
            )
        return settings

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """Hand on the next pictures; see ``FrameCamera.capture``."""
        self._stop_asked.clear()
        return capture_frames(
            path, frames, self._next, self.identify(), clock=self._clock, stop_asked=self._stop_asked
        )

    def stop(self) -> None:
        """End a capture after the present picture."""
        self._stop_asked.set()

    def close(self) -> None:
        """Nothing is held open."""

    def _next(self) -> Frame:
        if not self._pages:
            file = next(self._coming, None)
            if file is None:
                raise RecordingFailed(
                    f"All {self._taken} pictures have been taken.",
                    where=str(self._files[0].parent),
                    remedy="Ask for fewer, or add pictures.",
                )
            self._pages = list(read_frames(file))
        self._taken += 1
        return self._pages.pop(0)


class OpenCvFrameCamera:
    """A ``FrameCamera`` on a video source: a video device, a network camera's URL, a video or numbered files.

    Which device has which number is the computer's choice, and OpenCV knows no serial numbers: name a device by its
    id (``/dev/v4l/by-id/...``), and its serial number as USB tells it. A network camera tells none.

    Parameters
    ----------
    name
        What is opened.
    serial
        The serial number it must have; empty takes any.
    clock
        Passed through before each picture.
    system
        Where the system lists its video devices.
    """

    def __init__(self, name: str, *, serial: str = "", clock: Clock, system: Path = SYSTEM) -> None:
        self._name = name
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
            self._lock = CameraLock(str(self._device.resolve() if self._device else name))
        try:
            self._check_serial()
            self._source = self._opened(START_S)
        except BaseException:
            self.close()
            raise

    @classmethod
    def open(cls, source: str, *, serial: str = "", clock: Clock, system: Path = SYSTEM) -> OpenCvFrameCamera:
        """Open a source.

        Raises
        ------
        CameraNotFound
            When OpenCV cannot open it.
        CameraBusy
            When another process holds it.
        WrongDevice
            When it has another serial number, or tells none and one is named.
        """
        return cls(source, serial=serial, clock=clock, system=system)

    def identify(self) -> CameraIdentity:
        """Tell the source's name and size. Raises CameraLost, and WrongDevice when it is another one by now."""
        serial = self._check_serial()
        width = int(self._source.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._source.get(cv2.CAP_PROP_FRAME_HEIGHT))
        return CameraIdentity("", f"OpenCV {self._name}", "", serial, "", width, height)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Set exposure and gain in the driver's own units and see that it has them; no focusing by itself.

        Raises CameraSettingRefused.
        """
        if self._device is not None:
            self._source.set(cv2.CAP_PROP_AUTOFOCUS, 0.0)
            if self._source.get(cv2.CAP_PROP_AUTOFOCUS) > 0:
                raise self._refused("it goes on focusing by itself, and each focus is another focal length")
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
        """Take pictures; see ``FrameCamera.capture``. Those that were waiting from before are dropped.

        Raises RecordingFailed also where the camera repeats a picture.
        """
        self._stop_asked.clear()
        if self._network:
            # Any number of pictures may wait on the way from a network camera: a new connection has none of them.
            self._source.release()
            try:
                self._source = self._opened(SILENCE_S)
            except CameraNotFound as error:
                raise CameraLost(error.what, where=error.where, remedy=error.remedy) from error
        for _ in range(STALE_FRAMES if self._device is not None else 0):
            self._clock.sleep(0.0)
            if not self._source.grab():
                raise self._silent()
        seen = _FrozenCheck(self._last, frames, where=self._where)
        facts = capture_frames(
            path,
            frames,
            lambda: seen.look(self._next()) if self._is_live else self._next(),
            self.identify(),
            clock=self._clock,
            stop_asked=self._stop_asked,
        )
        self._last = seen.latest
        return facts

    def stop(self) -> None:
        """End a capture after the present picture."""
        self._stop_asked.set()

    def close(self) -> None:
        """Let the source go."""
        if self._source is not None:
            self._source.release()
        if self._lock is not None:
            self._lock.release()

    # ------------------------------------------------------------- inside

    @property
    def _is_live(self) -> bool:
        return self._device is not None or self._network

    @property
    def _where(self) -> str:
        return f"video source {self._name}"

    def _opened(self, within_s: float) -> Any:
        """Open the source anew. Raises CameraNotFound."""
        with _opencv_silenced():
            opened = self._capture(within_s)
        if not opened.isOpened():
            opened.release()
            raise CameraNotFound(
                f"OpenCV cannot open the video source {self._name!r}.",
                remedy="Check the number, path or URL, the cable, and that no other program uses it.",
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
                    remedy="Plug the camera in; `starbench devices` lists those that are there.",
                )
            found = usb_serial(self._device, self._system)
        if self._serial and found != self._serial:
            told = f"camera {found}" if found else "a camera that tells no serial number"
            raise WrongDevice(
                f"It is {told}, not {self._serial}.",
                where=self._where,
                remedy="Plug in the right camera, or correct the source or the serial number in the station file"
                " (without one, any camera will do).",
            )
        return found

    def _refused(self, why: str) -> CameraSettingRefused:
        return CameraSettingRefused(
            f"{why[0].upper()}{why[1:]}.",
            where=self._where,
            remedy="Set it with the camera's own program and leave it out of the station file, or use another camera.",
        )

    def _next(self) -> Frame:
        got, picture = self._source.read()
        if not got:
            raise self._silent()
        return to_grey(picture, where=self._where)

    def _silent(self) -> CameraLost:
        return CameraLost(
            "It sends no more pictures.",
            where=self._where,
            remedy="Check its cable and power; a video may have come to its end.",
        )


class _FrozenCheck:
    """Sees that a live camera does not repeat itself: no two pictures of a sensor are the same, noise sees to that.

    Parameters
    ----------
    before
        The last picture of the capture before.
    frames
        How many are to come.
    where
        The camera, for messages.
    """

    def __init__(self, before: Frame | None, frames: int, *, where: str) -> None:
        self.latest: Frame | None = None
        self._before = before
        self._frames = frames
        self._repeats = 0
        self._where = where

    def look(self, frame: Frame) -> Frame:
        """Pass a picture on. Raises RecordingFailed when it is the one from before, or all are alike."""
        if self._before is not None and np.array_equal(frame, self._before):
            raise self._frozen("It sent the last picture of the recording before once more")
        self._repeats += self.latest is not None and np.array_equal(frame, self.latest)
        self.latest = frame
        if 0 < self._repeats == self._frames - 1:
            raise self._frozen("All its pictures are the same to the last bit")
        return frame

    def _frozen(self, what: str) -> RecordingFailed:
        return RecordingFailed(
            f"{what}: it has frozen, or holds pictures back.",
            where=self._where,
            remedy="Restart the camera; see that its exposure and compression let the sensor's noise show.",
        )


@contextmanager
def _opencv_silenced() -> Iterator[None]:
    """Keep OpenCV and FFmpeg from writing to the terminal what the error says anyway."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read by OpenCV when it first uses FFmpeg
    logging = cv2.utils.logging
    before = logging.setLogLevel(logging.LOG_LEVEL_ERROR)
    try:
        yield
    finally:
        logging.setLogLevel(before)
