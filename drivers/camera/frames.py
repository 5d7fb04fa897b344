"""The interface of frame cameras, and the file that their frames go to: a lossless TIFF, one frame a page.

The file holds the camera's own grey values (8 or 16 bit, no gamma, no averaging). All results are computed from it.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraIdentity
from drivers.camera.image_size import require_bounded_images
from drivers.camera.raw_writer import check_new, check_space, sync_file
from drivers.clock import Clock
from drivers.errors import NotARecording, RecordingFailed, RecordingFileError

_PAUSE_S: Final = 0.1
"""Pause between two uses of the clock while frames are written, s."""

T = TypeVar("T")
Frame = NDArray[np.uint8] | NDArray[np.uint16]
"""Grey values of one frame, (height, width) uint8 or uint16."""


@dataclass(frozen=True)
class FrameSettings:
    """Settings made before a capture.

    Attributes
    ----------
    exposure, gain
        In the camera's own units; None leaves the value as it is.
    """

    exposure: float | None = None
    gain: float | None = None


@dataclass(frozen=True)
class FrameFacts:
    """What is known of a capture besides its pixels."""

    serial: str
    model: str
    # width, height: Size of a frame, px.
    width: int
    height: int
    bits: int  # Bit depth, 8 or 16
    frames: int
    bytes: int
    saturated_share: float  # Share of the pixels at the highest value, 0 to 1
    complete: bool = True  # False if the capture was stopped before its last frame


class FrameCamera(Protocol):
    """A frame camera. Its methods raise ``drivers.errors.DriverError`` and nothing else."""

    def identify(self) -> CameraIdentity:
        """Read the camera's identity.

        Returns
        -------
        CameraIdentity
            As far as the camera states it.

        Raises
        ------
        WrongDevice
            If the serial number differs from the one given when the camera was opened.
        """
        ...

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Set exposure and gain, and switch autofocus off.

        Parameters
        ----------
        settings
            The wanted settings.

        Returns
        -------
        FrameSettings
            What the camera has now.

        Raises
        ------
        CameraSettingRefused
            If the camera does not accept a setting, or its autofocus stays on.
        """
        ...

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """Take frames into a new TIFF, one a page, synced to disk.

        The call blocks, and calls the ``sleep`` of the clock given at opening before each frame.

        Parameters
        ----------
        path
            The file to make; it must not exist.
        frames
            Number of frames.

        Returns
        -------
        FrameFacts
            What is known of the capture.

        Raises
        ------
        RecordingFailed
            If the frames cannot be used, or the file cannot be written.
        CameraLost
            If the camera sends no frame.
        """
        ...

    def stop(self) -> None:
        """End a capture after the present frame. Callable from any thread."""
        ...

    def close(self) -> None:
        """Release the camera."""
        ...


def to_grey(image: NDArray[Any], *, where: str) -> Frame:
    """Return the grey values of an image of one, three (BGR) or four channels (BGRA).

    Colours are weighted as OpenCV does it, by ITU-R BT.601.

    image: (height, width) or (height, width, channels), uint8 or uint16.
    Returns: (height, width), of the same type.
    Raises RecordingFileError: If the pixels are neither 8 nor 16 bit.
    """
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3):
        raise RecordingFileError(
            f"The image has pixels of {image.dtype}, in an array of {image.ndim} dimensions.",
            where=where,
            remedy="Give images of 8 or 16 bit.",
        )
    if image.ndim == 2:
        return image
    if image.shape[2] == 1:
        return image[:, :, 0]
    import cv2

    weighted: Any = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY if image.shape[2] == 3 else cv2.COLOR_BGRA2GRAY)
    return weighted


def capture_frames(
    path: Path,
    frames: int,
    next_frame: Callable[[], Frame],
    camera: CameraIdentity,
    *,
    clock: Clock,
    stop_asked: threading.Event,
) -> FrameFacts:
    """Take frames one after the other and write them: the common part of every ``FrameCamera.capture``.

    Nothing is written if the capture is interrupted or the camera fails, because frames are quickly taken again.

    path: The file to make; it must not exist.
    camera: The camera, with the expected size of a frame.
    clock: Its ``sleep`` is called before each frame.
    stop_asked: Set by another thread to end the capture early.
    Raises RecordingFailed: If there is no frame, sizes or bit depths differ, or the file cannot be written.
    """
    check_new(path)
    taken: list[Frame] = []
    while len(taken) < frames and not stop_asked.is_set():
        clock.sleep(0.0)
        taken.append(next_frame())
    wanted = (camera.height, camera.width)
    if not taken or any(one.shape != wanted or one.dtype != taken[0].dtype for one in taken):
        raise RecordingFailed(
            f"The camera delivered {len(taken)} of {frames} frames; at least one is needed, and all must have "
            f"{camera.width} x {camera.height} px and one bit depth.",
            where=str(path),
            remedy="Request at least one frame, from a camera whose format does not change.",
        )
    written, saturated_share = _beside(clock, lambda: (write_frames(path, taken), _saturated_share(taken)))
    return FrameFacts(
        serial=camera.serial,
        model=camera.model,
        width=camera.width,
        height=camera.height,
        bits=8 * taken[0].dtype.itemsize,
        frames=len(taken),
        bytes=written,
        saturated_share=saturated_share,
        complete=len(taken) == frames,
    )


def _saturated_share(frames: Sequence[Frame]) -> float:
    highest = np.iinfo(frames[0].dtype).max
    return float(np.mean([(one == highest).mean() for one in frames]))


def _beside(clock: Clock, work: Callable[[], T]) -> T:
    """Do work that may take seconds in a thread, and use the clock meanwhile: a supervisor sees that it goes on."""
    with ThreadPoolExecutor(1, thread_name_prefix="frames") as worker:
        doing = worker.submit(work)
        while not doing.done():
            clock.monotonic()
            wait([doing], timeout=_PAUSE_S)
        return doing.result()


def write_frames(path: Path, frames: Sequence[Frame]) -> int:
    """Write frames of one size and bit depth as a new TIFF.

    path: The file to make; it must not exist.
    frames: The frames, at least one, each (height, width) uint8 or uint16.
    Returns: Length of the file, bytes.
    Raises RecordingFailed: If the file exists, or cannot be written.
    """
    check_new(path)
    partial = path.with_name(f"{path.stem}.partial.tiff")
    import cv2

    written = cv2.imwritemulti(str(partial), list(frames), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    if not written:
        partial.unlink(missing_ok=True)
        check_space(path)
        raise RecordingFailed(
            "The frames cannot be written.", where=str(path), remedy="Check the folder and the disk."
        )
    sync_file(partial)
    partial.rename(path)
    sync_file(path)
    return path.stat().st_size


def read_frames(path: Path) -> NDArray[Any]:
    """Read all images of a file.

    Returns: (n, height, width), uint8 or uint16: grey values.
    Raises NotARecording: If it holds no images of one size and bit depth, or states images that no file of
      its size can hold.
    Raises RecordingFileError: If it cannot be read.
    """
    if not path.is_file():
        raise RecordingFileError("There is no such file.", where=str(path), remedy="Check the path.")
    require_bounded_images(path)
    import cv2

    try:
        found, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise NotARecording(
            f"The picture cannot be decoded: {error.err}.",
            where=str(path),
            remedy="Give an original photograph.",
        ) from error
    frames = [to_grey(page, where=str(path)) for page in pages] if found else []
    if not frames or len({(frame.shape, frame.dtype) for frame in frames}) != 1:
        raise NotARecording(
            "The file holds no images of one size and bit depth.",
            where=str(path),
            remedy="Give an image or a TIFF of several pages.",
        )
    return np.stack(frames)


def mean_frame(path: Path) -> NDArray[np.float32]:
    """Read all images of a file, and average them.

    Returns: (height, width) float32, in units of the grey values.
    Raises NotARecording, RecordingFileError: As ``read_frames``.
    """
    return read_frames(path).mean(axis=0, dtype=np.float64).astype(np.float32)
