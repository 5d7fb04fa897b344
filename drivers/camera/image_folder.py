"""Play a folder of images, taken before, as a frame camera."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Final

from drivers.camera import CameraIdentity
from drivers.camera.frames import Frame, FrameFacts, FrameSettings, capture_frames, read_frames
from drivers.clock import Clock
from drivers.errors import CameraNotFound, CameraSettingRefused, RecordingFailed

IMAGE_SUFFIXES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")
"""Endings of the files that count as images."""


class FolderFrameCamera:
    """A ``FrameCamera`` that hands on the images of a folder: files in the order of their names, page by page.

    files: The images, at least one.
    serial: The serial number by the station file: images do not state it.
    clock: Its ``sleep`` is called before each frame.
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
        """Find the images of a folder.

        clock: Its ``sleep`` is called before each frame.
        Returns: The camera, at its first image.
        Raises CameraNotFound: If the folder holds no images.
        Raises NotARecording: If the first file is no image.
        """
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
        """Return the size of the images, and the serial number given. Images do not state which camera took them.

        Returns: The model is "pictures".
        """
        return CameraIdentity("", "pictures", "", self._serial, "", *self._size)

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Accept settings that change nothing.

        Raises CameraSettingRefused: If exposure or gain are given.
        """
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
