"""The interface of frame cameras, and the file that their frames go to: a lossless TIFF, one frame a page.

The file holds the camera's own grey values (8 or 16 bit, no gamma, no averaging). All results are computed from it.

A PNG of a megabyte can state 30 000 x 30 000 px. So the sizes that a file states are compared with the size of the
file before a decoder allocates memory. Only the structure of PNG, JPEG, BMP, PGM and TIFF is read here; the decoder is
OpenCV's.
"""

from __future__ import annotations

import re
import struct
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers.camera import CameraIdentity
from drivers.camera.raw_check import require_regular, require_whole
from drivers.camera.raw_writer import check_new, check_space, sync_file
from drivers.clock import Clock
from drivers.errors import NotARecording, RecordingFailed, RecordingFileError

MOST_PIXELS: Final = 1 << 28
"""Pixels that an image may have at most: twice those of the largest cameras."""
MOST_RATIO: Final = 100
"""How many times larger than its file an image may be. Photographs are compressed to a thirtieth at most."""
SMALL_PIXELS: Final = 1 << 23
"""Images of this size need no ratio: a drawn image can be compressed to almost nothing."""
MOST_PAGES: Final = 10_000
"""Images that a TIFF may have at most: a hostile file has no end of them."""
_MOST_SEGMENTS: Final = 10_000  # Of a JPEG before its picture; photographs have some tens
_PNM = re.compile(rb"P[1-6]\s+(?:#[^\n]*\n\s*)*([0-9]+)\s+(?:#[^\n]*\n\s*)*([0-9]+)")
_PAUSE_S: Final = 0.1
"""Pause between two uses of the clock while frames are written, s."""

T = TypeVar("T")
Frame = NDArray[np.uint8] | NDArray[np.uint16]
"""Grey values of one frame, (height, width) uint8 or uint16."""


class ImageSize(NamedTuple):
    """Size of an image."""

    width: int  # Columns, px
    height: int  # Rows, px


def require_bounded_images(path: Path) -> None:
    """Refuse a file whose images would take far more memory than the file could hold, or which is no ordinary file."""
    try:
        require_regular(path)
        require_whole(path)
        with path.open("rb") as file:
            sizes = image_sizes(file)
        length = path.stat().st_size
    except OSError as error:
        raise RecordingFileError(
            f"The file cannot be read ({error.strerror or error}).", where=str(path), remedy="Check the path."
        ) from error
    except (struct.error, ValueError) as error:
        raise _refused(path, f"The picture is damaged: {error}.") from error
    for size in sizes:
        if size.width * size.height > MOST_PIXELS:
            raise _refused(
                path, f"The picture has {size.width} x {size.height} px; at most {MOST_PIXELS} px are read."
            )
    pixels = sum(size.width * size.height for size in sizes)
    if pixels > max(SMALL_PIXELS, MOST_RATIO * length):
        raise _refused(
            path, f"The file states {pixels} px in {length} bytes; photographs cannot be compressed so far."
        )


def image_sizes(file: BinaryIO) -> list[ImageSize]:
    """Read the sizes that an open file, at its first byte, states for its images; empty for another kind of file.

    Raises `ValueError` if the structure is damaged or never ends, `struct.error` if the file ends too early.
    """
    start = file.read(4096)
    if start.startswith(b"\x89PNG\r\n\x1a\n"):
        return [ImageSize(*struct.unpack(">II", start[16:24]))]
    if start.startswith(b"BM"):
        width, height = struct.unpack("<ii", start[18:26])
        return [ImageSize(abs(width), abs(height))]
    if start.startswith(b"\xff\xd8"):
        return _jpeg(file)
    if start[:4] in (b"II*\0", b"MM\0*"):
        return _tiff(file, "<" if start[:1] == b"I" else ">")
    if header := _PNM.match(start):
        return [ImageSize(int(header[1]), int(header[2]))]
    return []


def _jpeg(file: BinaryIO) -> list[ImageSize]:
    """Find the frame header among the segments (ITU-T T.81, B.1)."""
    at = 2
    for _ in range(_MOST_SEGMENTS):
        file.seek(at)
        mark = file.read(2)
        while len(mark) == 2 and mark[1] == 0xFF:  # fill bytes
            at += 1
            mark = mark[1:] + file.read(1)
        if len(mark) < 2 or mark[0] != 0xFF:
            return []  # the decoder says what is wrong
        if 0xC0 <= mark[1] <= 0xCF and mark[1] not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", file.read(7)[3:])
            return [ImageSize(width, height)]
        if mark[1] in (0xD9, 0xDA):
            return []
        length = int.from_bytes(file.read(2), "big")
        at += 2 + max(length, 2)
    raise ValueError("its list of segments does not end")


def _tiff(file: BinaryIO, order: str) -> list[ImageSize]:
    """Walk the list of images (TIFF 6.0, section 2)."""
    sizes: list[ImageSize] = []
    seen: set[int] = set()
    file.seek(4)
    at = struct.unpack(order + "I", file.read(4))[0]
    while at:
        if at in seen or len(sizes) >= MOST_PAGES:
            raise ValueError("its list of images does not end")
        seen.add(at)
        file.seek(at)
        count = struct.unpack(order + "H", file.read(2))[0]
        entries = file.read(12 * count)
        size = {256: 0, 257: 0}
        for k in range(count):
            tag, kind, _, value = struct.unpack(order + "HHII", entries[12 * k : 12 * k + 12])
            if tag in size:
                size[tag] = (
                    struct.unpack(order + "H", entries[12 * k + 8 : 12 * k + 10])[0] if kind == 3 else value
                )
        sizes.append(ImageSize(size[256], size[257]))
        at = struct.unpack(order + "I", file.read(4))[0]
    return sizes


def _refused(path: Path, what: str) -> NotARecording:
    return NotARecording(what, where=str(path), remedy="Give an original photograph of the target.")


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
    width: int  # Of a frame, px
    height: int  # Of a frame, px
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

    def stop(self) -> None:
        """End a capture after the present frame. Callable from any thread."""

    def close(self) -> None:
        """Release the camera."""


def to_grey(image: NDArray[Any], *, where: str) -> Frame:
    """Return the grey values of an image of one, three (BGR) or four channels (BGRA), weighted by ITU-R BT.601.

    The image is (height, width) or (height, width, channels), uint8 or uint16, else `RecordingFileError` is raised; the
    result is (height, width), of the same type.
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

    Nothing is written if the capture is interrupted or the camera fails, because frames are quickly taken again. The
    path must not exist; ``camera`` states the expected size of a frame; the clock's ``sleep`` is called before each
    frame. ``stop_asked`` is set by another thread to end the capture early. Raises `RecordingFailed` if there is no
    frame, sizes or bit depths differ, or the file cannot be written.
    """
    check_new(path)
    taken: list[Frame] = []
    while len(taken) < frames and not stop_asked.is_set():
        clock.sleep(0.0)
        taken.append(next_frame())
    wanted = (camera.height, camera.width)
    if not taken or any(frame.shape != wanted or frame.dtype != taken[0].dtype for frame in taken):
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
    return float(np.mean([(frame == highest).mean() for frame in frames]))


def _beside(clock: Clock, work: Callable[[], T]) -> T:
    """Do work that may take seconds in a thread, and use the clock meanwhile: a supervisor sees that it goes on."""
    with ThreadPoolExecutor(1, thread_name_prefix="frames") as worker:
        doing = worker.submit(work)
        while not doing.done():
            clock.monotonic()
            wait([doing], timeout=_PAUSE_S)
        return doing.result()


def write_frames(path: Path, frames: Sequence[Frame]) -> int:
    """Write one or more frames, (height, width) uint8 or uint16, all alike, as a new TIFF; return its length, bytes."""
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
    """Read all images of a file: (n, height, width), uint8 or uint16 grey values.

    Raises `NotARecording` if it holds no images of one size and bit depth, or states images that no file of its size
    can hold.
    """
    if not path.is_file():
        raise RecordingFileError("There is no such file.", where=str(path), remedy="Check the path.")
    require_bounded_images(path)
    import cv2

    try:
        is_read, pages = cv2.imreadmulti(str(path), flags=cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise NotARecording(
            f"The picture cannot be decoded: {error.err}.",
            where=str(path),
            remedy="Give an original photograph.",
        ) from error
    frames = _without_thumbnails([to_grey(page, where=str(path)) for page in pages] if is_read else [])
    if not frames or len({(frame.shape, frame.dtype) for frame in frames}) != 1:
        raise NotARecording(
            "The file holds no images of one size and bit depth.",
            where=str(path),
            remedy="Give an image or a TIFF of several pages.",
        )
    return np.stack(frames)


def _without_thumbnails(frames: list[NDArray[Any]]) -> list[NDArray[Any]]:
    """Leave out the pages of a TIFF that are at most half as wide as its widest one: previews for other programs."""
    widest = max((frame.shape[1] for frame in frames), default=0)
    return [frame for frame in frames if 2 * frame.shape[1] > widest]


def mean_frame(path: Path) -> NDArray[np.float32]:
    """Average all images of a file, in units of the grey values: (height, width) float32."""
    return read_frames(path).mean(axis=0, dtype=np.float64).astype(np.float32)
