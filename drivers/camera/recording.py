"""Record from a camera whose driver hands on the camera's own words: words, file, facts.

The recording ends when the sensor's clock (not the computer's) has covered the duration. However it ends, its file is
complete up to that point and readable. No camera is known here: its driver provides a ``WordSource``.
"""

from __future__ import annotations

import math
import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol, Self

import numpy as np

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.evt3 import Evt3Decoder, StreamStatistics
from drivers.camera.raw_writer import RawWriter
from drivers.camera.usb_permission import check_link
from drivers.clock import Clock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraSettingRefused,
    DriverError,
    RecordingFailed,
    WrongDevice,
)
from drivers.file_lock import CameraLock, event_camera_name
from drivers.serial_number import is_same_serial

_CLOCK_AT_ZERO: Final = b"\x00\x80\x00\x60"
"""TIME_HIGH and TIME_LOW: the shortest valid stream."""
BIASES: Final = ("bias_diff_on", "bias_diff_off", "bias_fo", "bias_hpf", "bias_refr")
"""The biases that CameraSettings may name. ``bias_diff`` is the reference of two of them and is never changed."""


class WordSource(Protocol):
    """A stream of EVT3 words, provided by a driver."""

    def start(self) -> None:
        """Start the stream."""

    def next_words(self) -> bytes | None:
        """Wait for the next whole words, some 10 ms at most: None if none came, empty if the stream has ended."""

    def stop(self, *, hurry: bool) -> None:
        """Stop the stream, without passing the clock; with ``hurry``, when something else failed already, quickly."""


@dataclass(frozen=True)
class RecordingOutcome:
    """The result of a recording."""

    statistics: StreamStatistics  # Counts, times and losses of its words
    bytes: int
    complete: bool  # Whether the recording covers its whole duration


def connection_lost(
    how: str, where: str, remedy: str = "Check the camera's cable and power, then resume the run."
) -> CameraLost:
    """Build the error of a camera that its software reaches no more."""
    return CameraLost(f"The connection to the camera is lost ({how}).", where=where, remedy=remedy)


def compile_decoder() -> None:
    """Compile the loop that counts words, so that the first recording does not wait for the compiler."""
    Evt3Decoder(1, 1).tally(np.frombuffer(_CLOCK_AT_ZERO, "<u2"))


def refuse_roi(settings: CameraSettings, where: str) -> None:
    """Refuse a region of interest, for drivers that cannot set one."""
    if settings.roi is not None:
        raise CameraSettingRefused(
            "This driver cannot set a region of interest.",
            where=where,
            remedy="Leave roi out of the station file.",
        )


def refuse_unknown_biases(settings: CameraSettings, known: Sequence[str], where: str) -> None:
    """Refuse biases that a camera does not have. Raises CameraSettingRefused."""
    if unknown := sorted(set(settings.biases) - set(known)):
        raise CameraSettingRefused(
            f"The camera has no bias {', '.join(unknown)}.",
            where=where,
            remedy=f"Use the biases of this camera: {', '.join(known)}.",
        )


def refuse_filters(filters: Mapping[str, bool], where: str) -> None:
    """Refuse filters that are on after they were switched off. Raises CameraSettingRefused."""
    if left_on := [name for name, on in filters.items() if on]:
        raise CameraSettingRefused(
            f"The on-chip filters {', '.join(left_on)} could not be switched off.",
            where=where,
            remedy="Reconnect or restart the camera; a filter falsifies the recording.",
        )


def check_bias(name: str, value: int, lowest: int, highest: int, where: str) -> None:
    """Check that a camera accepts the value of a bias. Raises CameraSettingRefused."""
    if not lowest <= value <= highest:
        raise CameraSettingRefused(
            f"The camera accepts {name} from {lowest} to {highest}, not {value}.",
            where=where,
            remedy="Correct the bias in the station file.",
        )


class EventCameraDriver(ABC):
    """What the drivers of event cameras share; ``serial`` None accepts any camera."""

    SILENCE_S: ClassVar[float]
    """How long the sensor's clock may stand still before the camera counts as lost, s."""
    OTHER_CAMERA_REMEDY: ClassVar[str]

    def __init__(self, *, serial: str | None, clock: Clock) -> None:
        self._serial = serial
        self._clock = clock
        self._stop_asked = threading.Event()

    @property
    @abstractmethod
    def _where(self) -> str:
        """Name of the camera in messages."""

    def stop(self) -> None:
        """End a recording at the next words that come. Callable from any thread."""
        self._stop_asked.set()

    def _require_serial(self, identity: CameraIdentity) -> CameraIdentity:
        """Return the identity; raise WrongDevice if another camera was asked for when this one was opened."""
        if self._serial is not None and not is_same_serial(identity.serial, self._serial):
            raise WrongDevice(
                f"This is camera {identity.serial}, not {self._serial}.",
                where=self._where,
                remedy=self.OTHER_CAMERA_REMEDY,
            )
        return identity

    def _silent(self) -> CameraLost:
        return CameraLost(
            f"The sensor's clock has stood still for {self.SILENCE_S:g} s.",
            where=self._where,
            remedy="Check the camera's cable and power (or its simulator), then resume the run.",
        )

    def _begin(self, duration_s: float) -> None:
        """Begin a recording; raise `RecordingFailed` if its duration is not positive and finite."""
        if not (math.isfinite(duration_s) and duration_s > 0):
            raise RecordingFailed(
                f"A recording of {duration_s} s is not possible.",
                where=self._where,
                remedy="Request a finite duration above 0 s.",
            )
        self._stop_asked.clear()

    def record_words(
        self, source: WordSource, path: Path, header: bytes, size: tuple[int, int], duration_s: float
    ) -> RecordingOutcome:
        """Write a source's words into a new file until the sensor's clock has covered the duration (inf: all words).

        ``header`` holds the first bytes, ``size`` columns and rows of the sensor, px. Raises `RecordingFailed` if the
        file cannot be made or written, or the words are malformed, `CameraLost` if the camera goes away or falls
        silent; what was recorded before is kept.
        """
        decoder = Evt3Decoder(*size, where=self._where)
        with RawWriter(path, header) as file:
            try:
                source.start()
                complete = self._write_words(source, file, decoder, duration_s)
            except BaseException as error:
                # The first error is the one to report. Stopping is not interruptible here, and short.
                with suppress(DriverError):
                    source.stop(hurry=True)
                if isinstance(error, DriverError) and not isinstance(error, RecordingFailed):
                    raise incomplete_recording_error(error, path) from error
                raise
            source.stop(hurry=False)
        return RecordingOutcome(decoder.statistics(), file.bytes_written, complete)

    def _write_words(
        self, source: WordSource, file: RawWriter, decoder: Evt3Decoder, duration_s: float
    ) -> bool:
        """Write until the duration is covered (True), or until stopped or at the end of the stream (False)."""
        wanted_us = duration_s * 1e6
        covered_us = -1
        deadline = 0.0
        while decoder.covered_us < wanted_us:
            if self._stop_asked.is_set():
                return False
            if decoder.covered_us > covered_us:
                covered_us = decoder.covered_us
                deadline = self._clock.monotonic() + self.SILENCE_S
            elif self._clock.monotonic() > deadline:
                raise self._silent()
            self._clock.sleep(0.0)
            words = source.next_words()
            if words == b"":
                return False
            if words is not None:
                file.write(words)
                decoder.tally(np.frombuffer(words, "<u2"))
        return True


class UsbCameraDriver(EventCameraDriver):
    """A camera on USB behind other people's software, reserved for this process until it is closed."""

    SILENCE_S = 5.0  # A sensor that streams sends its clock every 16 us.
    OTHER_CAMERA_REMEDY = "Correct the serial number in the station file, or plug in the right camera."
    _device: Any
    _lock: CameraLock | None = None

    @abstractmethod
    def identify(self) -> CameraIdentity:
        """See `EventCamera.identify`."""

    @abstractmethod
    def close(self) -> None:
        """See `EventCamera.close`."""

    @abstractmethod
    def _opened(self) -> Any:
        """Return the open device of that software. Raises CameraNotFound."""

    def _check_opened(self, identity: CameraIdentity) -> None:
        """Refuse a camera that cannot be used; most can."""

    def open_device(self) -> Self:
        """Open the camera; one whose number is known is locked before it is touched. An error leaves it closed."""
        if self._serial:
            self._lock = CameraLock(event_camera_name(self._serial))
        try:
            self._device = self._opened()
            identity = self.identify()
            self._check_opened(identity)
            check_link(identity.link_mbit_s, self._where)
            if self._lock is None:
                self._lock = CameraLock(event_camera_name(identity.serial))
        except BaseException:
            self.close()
            raise
        return self


def incomplete_recording_error(error: DriverError, path: Path) -> CameraError:
    """Build the error of an interrupted recording: what happened, and which file holds what was recorded before.

    It is ``CameraLost`` if the error is one, else ``RecordingFailed``.
    """
    kind = CameraLost if isinstance(error, CameraLost) else RecordingFailed
    what = f"{error.what} The recording is incomplete; what was recorded before is in {path}."
    return kind(what, where=error.where, remedy=error.remedy)


def recording_facts(
    camera: CameraIdentity,
    recorded: RecordingOutcome,
    *,
    biases: Mapping[str, int],
    filters: Mapping[str, bool],
    temperature_c: float | None,
    illumination_lux: float | None,
    losses: Sequence[str] = (),
) -> RecordingFacts:
    """Put together what is known of a recording; temperature (deg C) and illumination (lx) are None if not measured."""
    statistics = recorded.statistics
    return RecordingFacts(
        serial=camera.serial,
        model=camera.model,
        width=camera.width,
        height=camera.height,
        bytes=recorded.bytes,
        duration_s=statistics.duration_s,
        events=statistics.events,
        triggers=statistics.triggers,
        biases=biases,
        filters=filters,
        rate_controller_in=statistics.rate_controller_in,
        rate_controller_out=statistics.rate_controller_out,
        temperature_c=temperature_c,
        illumination_lux=illumination_lux,
        gaps=(*losses, *statistics.loss_messages()),
        complete=recorded.complete,
    )
