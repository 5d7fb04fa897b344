"""Frame cameras: whatever OpenCV opens as a video source, and folders of pictures taken before."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any, Final

import cv2

from drivers.camera import CameraIdentity
from drivers.camera.frames import Frame, FrameFacts, capture_frames, grey, read_frames
from drivers.clock import Clock
from drivers.errors import CameraLost, CameraNotFound, RecordingFailed

PICTURES: Final = (".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".tif", ".tiff")

STALE_FRAMES: Final = 4
"""Pictures that a video source may hold from before it was asked: as many are dropped."""


class FolderFrameCamera:
    """A ``FrameCamera`` that hands on the pictures of a folder, in the order of their names.

    Parameters
    ----------
    files
        The pictures.
    clock
        Passed through before each.
    """

    def __init__(self, files: list[Path], *, clock: Clock) -> None:
        self._files = files
        self._clock = clock
        self._stop_asked = threading.Event()
        self._taken = 0
        first = read_frames(files[0])
        self._size = first.shape[2], first.shape[1]

    @classmethod
    def open(cls, folder: Path | str, *, clock: Clock) -> FolderFrameCamera:
        """Find the pictures. Raises CameraNotFound when there are none, NotARecording for one that is none."""
        folder = Path(folder)
        files = sorted(path for path in folder.glob("*") if path.suffix.lower() in PICTURES)
        if not files:
            raise CameraNotFound(
                "No pictures are in this folder.",
                where=str(folder),
                remedy=f"Name a folder with {', '.join(PICTURES)}.",
            )
        return cls(files, clock=clock)

    def identify(self) -> CameraIdentity:
        """Pictures do not say who took them: only their size is known."""
        return CameraIdentity("", "pictures", "", "", "", *self._size)

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
        if self._taken == len(self._files):
            raise RecordingFailed(
                f"All {self._taken} pictures have been taken.",
                where=str(self._files[0].parent),
                remedy="Ask for fewer, or add pictures.",
            )
        frame: Frame = read_frames(self._files[self._taken])[0]
        self._taken += 1
        return frame


class OpenCvFrameCamera:
    """A ``FrameCamera`` on a video source: a camera by its number, a URL, a video or a pattern of file names.

    OpenCV knows no serial numbers: which camera has which number is the computer's choice.

    Parameters
    ----------
    source
        An open ``cv2.VideoCapture``.
    name
        What was opened.
    clock
        Passed through before each picture.
    live
        Whether pictures of the past may be waiting in it, to be dropped.
    """

    def __init__(self, source: Any, name: str, *, clock: Clock, live: bool) -> None:
        self._source = source
        self._name = name
        self._clock = clock
        self._live = live
        self._stop_asked = threading.Event()

    @classmethod
    def open(cls, source: int | str, *, clock: Clock) -> OpenCvFrameCamera:
        """Open a source. Raises CameraNotFound."""
        opened = cv2.VideoCapture(source)
        if not opened.isOpened():
            opened.release()
            raise CameraNotFound(
                f"OpenCV cannot open the video source {source!r}.",
                remedy="Check the number, path or URL, the cable, and that no other program uses it.",
            )
        live = isinstance(source, int) or not ("%" in source or Path(source).is_file())
        return cls(opened, str(source), clock=clock, live=live)

    def identify(self) -> CameraIdentity:
        """Tell the source's name and the size it sends."""
        width = int(self._source.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._source.get(cv2.CAP_PROP_FRAME_HEIGHT))
        return CameraIdentity("", f"OpenCV {self._name}", "", "", "", width, height)

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """Take pictures; see ``FrameCamera.capture``. Those that were waiting from before are dropped."""
        self._stop_asked.clear()
        for _ in range(STALE_FRAMES if self._live else 0):
            self._clock.sleep(0.0)
            self._source.grab()
        return capture_frames(
            path, frames, self._next, self.identify(), clock=self._clock, stop_asked=self._stop_asked
        )

    def stop(self) -> None:
        """End a capture after the present picture."""
        self._stop_asked.set()

    def close(self) -> None:
        """Let the source go."""
        self._source.release()

    def _next(self) -> Frame:
        got, picture = self._source.read()
        if not got:
            raise CameraLost(
                "It sends no more pictures.",
                where=f"video source {self._name}",
                remedy="Check its cable and power; a video may have come to its end.",
            )
        return grey(picture, where=f"video source {self._name}")
