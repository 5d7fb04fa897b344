"""Driver of frame cameras: every video source that OpenCV opens.

OpenCV identifies cameras by numbers that change from one start to the next, and has no serial numbers. Linux has
both: it names a device after its camera (``/dev/v4l/by-id``), and states the serial number that the camera gave on USB.
A folder of images, taken before, is played as a camera too.
"""

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

from drivers.camera import CameraIdentity, FoundCamera
from drivers.camera.frames import Frame, FrameFacts, FrameSettings, capture_frames, read_frames, to_grey
from drivers.clock import Clock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    RecordingFailed,
    WrongDevice,
)
from drivers.file_lock import CameraLock
from drivers.serial_number import is_same_serial

DEV: Final = Path("/dev")
"""Folder of the device files."""
SYSTEM: Final = Path("/sys/class/video4linux")
"""Folder in which Linux lists its video devices."""
IMAGE_SUFFIXES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")
"""Endings of the files that count as images."""

STALE_FRAMES: Final = 5
"""Number of old frames that a video device may hand out: four in its buffers, and the one that is being exposed."""

START_S: Final = 60.0
"""Longest time until a network camera's first frame after it is opened, s."""

SILENCE_S: Final = 10.0
"""Longest time without a frame later, s; for a video device of Linux, OpenCV waits as long."""

_MANUAL_EXPOSURE: Final = 1.0
"""V4L2's value of manual exposure."""


def device_path(source: str, dev: Path = DEV) -> Path | None:
    """Return the device file that ``0``, ``/dev/video0`` or a name by id stands for; None for what is no device.

    >>> device_path("0").as_posix(), device_path("rtsp://camera/1"), device_path("pose_%03d.png")
    ('/dev/video0', None, None)
    """
    if source.isdecimal():
        return dev / f"video{int(source)}"
    path = Path(source)
    return path.resolve() if path.is_absolute() and path.is_relative_to(dev) else None


def usb_serial(device: Path, system: Path = SYSTEM) -> str:
    """Read the serial number of the USB device that a video device belongs to; empty if it has none."""
    place = (system / device.name / "device").resolve()
    for folder in (place, *place.parents):
        if (folder / "idVendor").is_file():  # the USB device itself; below it are its interfaces
            try:
                return (folder / "serial").read_text(encoding="utf-8", errors="replace").strip()
            except OSError:
                return ""
    return ""


def is_capture_device(device: Path, system: Path = SYSTEM) -> bool:
    """Return whether a video device is the first of its camera, or the system does not say.

    The others carry metadata, which OpenCV cannot read.
    """
    try:
        return (system / device.name / "index").read_text(encoding="ascii").strip() == "0"
    except OSError:
        return True


def video_devices(dev: Path = DEV, system: Path = SYSTEM) -> list[FoundCamera]:
    """List the video devices as frame cameras."""
    by_id = dev / "v4l" / "by-id"
    names = {link.resolve(): link for link in by_id.iterdir()} if by_id.is_dir() else {}
    devices = [path for path in sorted(dev.glob("video[0-9]*")) if is_capture_device(path, system)]
    return [
        FoundCamera(
            driver="opencv",
            serial=usb_serial(device, system),
            description=f"video device {device}",
            source=str(names.get(device.resolve(), device)),
        )
        for device in devices
    ]


class FolderFrameCamera:
    """A ``FrameCamera`` that hands on the images of a folder: files in the order of their names, page by page.

    There is at least one file; the serial number is the station file's, as images do not state it. The clock's
    ``sleep`` is called before each frame.
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
        """Find the images of a folder; refuse one without images, or whose first file is no image."""
        folder = Path(folder)
        files = sorted(path for path in folder.glob("*") if path.suffix.lower() in IMAGE_SUFFIXES)
        if not files:
            raise CameraNotFound(
                "This folder holds no images.",
                where=str(folder),
                remedy=f"Give a folder with files that end in {', '.join(IMAGE_SUFFIXES)}.",
            )
        return cls(files, serial=serial, clock=clock)

    def identify(self) -> CameraIdentity:
        """Return the size of the images, the serial number given, and the model "pictures": images name no camera."""
        return CameraIdentity("", "pictures", "", self._serial, "", *self._size)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Accept settings that change nothing; refuse an exposure or a gain."""
        if settings != FrameSettings():
            raise CameraSettingRefused(
                "Exposure and gain of images cannot be changed after they were taken.",
                where=str(self._files[0].parent),
                remedy="Leave exposure and gain out of the station file.",
            )
        return settings

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """See `FrameCamera.capture`."""
        self._stop_asked.clear()
        return capture_frames(
            path, frames, self._next, self.identify(), clock=self._clock, stop_asked=self._stop_asked
        )

    def stop(self) -> None:
        """See `FrameCamera.stop`."""
        self._stop_asked.set()

    def close(self) -> None:
        """Do nothing: no file stays open."""

    def _next(self) -> Frame:
        if not self._pages:
            file = next(self._coming, None)
            if file is None:
                raise RecordingFailed(
                    f"All {self._taken} images have been used.",
                    where=str(self._files[0].parent),
                    remedy="Request fewer frames, or add images to the folder.",
                )
            self._pages = list(read_frames(file))
        self._taken += 1
        return self._pages.pop(0)


class OpenCvFrameCamera:
    """A ``FrameCamera`` on a video source: a video device, a network camera's URL, a video or numbered files.

    The computer chooses which device has which number, and OpenCV has no serial numbers. So a station file should name
    a device by its id (``/dev/v4l/by-id/...``), and its serial number as USB states it; empty accepts any. A network
    camera states none. The clock's ``sleep`` is called before each frame. ``shown_as`` stands for a name that is secret
    in messages and in the camera's identity.
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
        """Open a video source; the arguments as for the class.

        Raises `CameraBusy` if another process has locked it, `WrongDevice` if the camera has another serial number than
        the one given, or none.
        """
        return cls(source, serial=serial, clock=clock, system=system, shown_as=shown_as)

    def identify(self) -> CameraIdentity:
        """Return serial number, frame size, and as model "OpenCV" and the source's name.

        Raises `CameraLost` if the video device does not exist any more, `WrongDevice` if it is another camera by now.
        """
        self._require_open()
        serial = self._check_serial()
        width = int(self._source.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._source.get(cv2.CAP_PROP_FRAME_HEIGHT))
        return CameraIdentity("", f"OpenCV {self._shown_as}", "", serial, "", width, height)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Set exposure and gain in the driver's own units, read them back to within 1 %, and switch autofocus off."""
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
        """Take frames; see `FrameCamera.capture`. Older buffered ones are dropped, a repeated frame is refused."""
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
        serial = ""
        if self._device is not None:
            if self._system.is_dir() and not (self._system / self._device.name).exists():
                gone = CameraNotFound if self._source is None else CameraLost
                raise gone(
                    "There is no such video device.",
                    where=self._where,
                    remedy="Plug the camera in; `starbench devices` lists the connected cameras.",
                )
            serial = usb_serial(self._device, self._system)
        if self._serial and not is_same_serial(serial, self._serial):
            answer = f"camera {serial}" if serial else "a camera without a serial number"
            raise WrongDevice(
                f"This is {answer}, not {self._serial}.",
                where=self._where,
                remedy="Plug in the right camera, or correct the source or the serial number in the station file."
                " Without a serial number there, any camera is accepted.",
            )
        return serial

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

    ``before`` is the last frame of the previous capture.
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
