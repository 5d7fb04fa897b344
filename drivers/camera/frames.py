"""What the bench expects of a frame camera, and the file its pictures go to: a TIFF of many pages, lossless.

The camera's own grey values are kept (8 or 16 bit, no gamma, no averaging); what is made of them is computed from
the file.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraIdentity
from drivers.camera.raw_writer import check_new, check_space, sync_file
from drivers.clock import Clock
from drivers.errors import NotARecording, RecordingFailed, RecordingFileError

Frame = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class FrameSettings:
    """What is set before taking pictures, in the camera's own units; None leaves it as it is."""

    exposure: float | None = None
    gain: float | None = None


@dataclass(frozen=True)
class FrameFacts:
    """What is known of pictures besides their pixels.

    ``bits`` is 8 or 16; ``saturated_share`` the share of pixels at the highest value; ``complete`` is False when
    stopped before the last picture.
    """

    serial: str
    model: str
    width: int
    height: int
    bits: int
    frames: int
    bytes: int
    saturated_share: float
    complete: bool = True


class FrameCamera(Protocol):
    """A frame camera. All methods raise ``drivers.errors.DriverError`` and nothing else."""

    def identify(self) -> CameraIdentity:
        """Say who it is. Raises WrongDevice when the serial number differs from the given one."""
        ...

    def apply(self, settings: FrameSettings) -> FrameSettings:
        """Set exposure and gain, hold the focus where it is; return what was read back.

        Raises CameraSettingRefused when the camera does not take a setting, or goes on focusing by itself.
        """
        ...

    def capture(self, path: Path, frames: int) -> FrameFacts:
        """Take that many pictures into a new TIFF, one a page, synced to disk.

        Blocks; passes through the clock given at opening before each picture. Raises RecordingFailed, CameraLost.
        """
        ...

    def stop(self) -> None:
        """End a capture after the present picture; callable from any thread."""
        ...

    def close(self) -> None:
        """Let the camera go."""
        ...


def to_grey(picture: NDArray[Any], *, where: str) -> Frame:
    """Give the grey values of a picture of one, three (BGR) or four channels.

    Raises RecordingFileError when its pixels are neither 8 nor 16 bit.
    """
    if picture.dtype not in (np.uint8, np.uint16) or picture.ndim not in (2, 3):
        raise RecordingFileError(
            f"Its pixels are {picture.dtype}, in an array of {picture.ndim} dimensions.",
            where=where,
            remedy="Give pictures of 8 or 16 bit.",
        )
    if picture.ndim == 2:
        return picture
    if picture.shape[2] == 1:
        return picture[:, :, 0]
    weighted: Any = cv2.cvtColor(
        picture, cv2.COLOR_BGR2GRAY if picture.shape[2] == 3 else cv2.COLOR_BGRA2GRAY
    )
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
    """Take pictures one after the other and write them: what every ``FrameCamera.capture`` does.

    Nothing is written when it is interrupted or the camera fails: pictures are quickly taken again.

    Raises
    ------
    RecordingFailed
        When there is no picture to write, one has another size or depth, or the file cannot be written.
    """
    check_new(path)
    taken: list[Frame] = []
    while len(taken) < frames and not stop_asked.is_set():
        clock.sleep(0.0)
        taken.append(next_frame())
    wanted = (camera.height, camera.width)
    if not taken or any(one.shape != wanted or one.dtype != taken[0].dtype for one in taken):
        raise RecordingFailed(
            f"{len(taken)} of {frames} pictures, not all of {camera.width} x {camera.height} px and one depth.",
            where=str(path),
            remedy="Ask for one picture at least, of a camera whose format does not change.",
        )
    highest = np.iinfo(taken[0].dtype).max
    return FrameFacts(
        serial=camera.serial,
        model=camera.model,
        width=camera.width,
        height=camera.height,
        bits=8 * taken[0].dtype.itemsize,
        frames=len(taken),
        bytes=write_frames(path, taken),
        saturated_share=float(np.mean([(one == highest).mean() for one in taken])),
        complete=len(taken) == frames,
    )


def write_frames(path: Path, frames: Sequence[Frame]) -> int:
    """Write pictures of one size and depth as a new TIFF; returns its length in bytes.

    Raises
    ------
    RecordingFailed
        When there is such a file, or it cannot be written.
    """
    check_new(path)
    partial = path.with_name(f"{path.stem}.partial.tiff")
    written = cv2.imwritemulti(str(partial), list(frames), [cv2.IMWRITE_TIFF_COMPRESSION, 1])
    if not written:
        partial.unlink(missing_ok=True)
        check_space(path)
        raise RecordingFailed(
            "The pictures cannot be written.", where=str(path), remedy="Check the folder and the disk."
        )
    sync_file(partial)
    partial.rename(path)
    sync_file(path)
    return path.stat().st_size


def read_frames(path: Path) -> NDArray[Any]:
    """All pictures of a file: (n, height, width), uint8 or uint16.

    Raises
    ------
    NotARecording
        When it holds no pictures of one size.
    RecordingFileError
        When it cannot be read.
    """
    if not path.is_file():
        raise RecordingFileError("There is no such file.", where=str(path), remedy="Check the path.")
    found, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    frames = [to_grey(page, where=str(path)) for page in pages] if found else []
    if not frames or len({(frame.shape, frame.dtype) for frame in frames}) != 1:
        raise NotARecording(
            "It holds no pictures of one size and depth.", where=str(path), remedy="Give a picture or a TIFF."
        )
    return np.stack(frames)


def mean_frame(path: Path) -> NDArray[np.float32]:
    """Mean of all pictures of a file, (height, width), in units of their grey values. Raises as ``read_frames``."""
    return read_frames(path).mean(axis=0, dtype=np.float64).astype(np.float32)
