"""One recording, as every driver that hands on the camera's own words makes it: words, file, facts.

Knows when a recording is long enough (by the sensor's clock, not the computer's), what is told of it, and that
its file is whole and readable however it ends. Knows no camera.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.evt3 import Evt3Decoder, StreamStatistics
from drivers.camera.raw_writer import RawWriter
from drivers.clock import Clock
from drivers.errors import CameraError, CameraLost, CameraSettingRefused, DriverError, RecordingFailed

_CLOCK_AT_ZERO: Final = b"\x00\x80\x00\x60"
"""TIME_HIGH and TIME_LOW: the shortest stream there is."""


class WordSource(Protocol):
    """A stream of EVT3 words, as a driver offers it."""

    def start(self) -> None:
        """Let the stream begin."""
        ...

    def next_words(self) -> bytes | None:
        """Return the next whole words, None when none come for some 10 ms, nothing (b"") when it has ended."""
        ...

    def stop(self, *, hurry: bool) -> None:
        """Let the stream end; in a hurry when something else has gone wrong. Does not pass the clock."""
        ...


@dataclass(frozen=True)
class Watch:
    """What may end a recording before its time.

    Attributes
    ----------
    clock
        Each round of the recording passes through its ``sleep``.
    stop_asked
        Set by another thread to end the recording early.
    silence_s
        How long the sensor's clock may stand still before the camera counts as lost.
    where
        The camera, for messages.
    """

    clock: Clock
    stop_asked: threading.Event
    silence_s: float
    where: str


@dataclass(frozen=True)
class Recorded:
    """How a recording went: what its words told, bytes of the file, and whether it lasted its time."""

    statistics: StreamStatistics
    bytes: int
    complete: bool


def get_ready() -> None:
    """Have what counts words along compiled, so that the first recording does not wait for it."""
    Evt3Decoder(1, 1).tally(np.frombuffer(_CLOCK_AT_ZERO, "<u2"))


def check_duration(duration_s: float, *, where: str) -> None:
    """Raise RecordingFailed when nobody can record that long."""
    if not (math.isfinite(duration_s) and duration_s > 0):
        raise RecordingFailed(
            f"A recording of {duration_s} s was asked for.",
            where=where,
            remedy="Ask for some milliseconds at least.",
        )


def refuse_roi(settings: CameraSettings, where: str) -> None:
    """Raise CameraSettingRefused for a region of interest, where a driver sets none."""
    if settings.roi is not None:
        raise CameraSettingRefused(
            "Its driver sets no region of interest.", where=where, remedy="Leave roi out of the station file."
        )


def record_words(
    source: WordSource, path: Path, header: bytes, size: tuple[int, int], duration_s: float, watch: Watch
) -> Recorded:
    """Write a source's words into a new file until the sensor's clock has covered the duration.

    Parameters
    ----------
    source
        Where the words come from; it is stopped in any case.
    path, header
        The new file and how it begins.
    size
        Columns and rows of the sensor.
    duration_s
        At least this long of the sensor's clock, s; infinite for all there is.
    watch
        What may end it before.

    Raises
    ------
    RecordingFailed
        When the file cannot be made or written, or the words are malformed; what came before is kept.
    CameraLost
        When the camera goes away or falls silent; what came before is kept.
    """
    decoder = Evt3Decoder(*size, where=watch.where)
    with RawWriter(path, header) as file:
        try:
            source.start()
            complete = _write_words(source, file, decoder, duration_s, watch)
        except BaseException as error:
            # The first trouble is the one to tell; the way out is not interrupted, and short.
            with suppress(DriverError):
                source.stop(hurry=True)
            if isinstance(error, DriverError) and not isinstance(error, RecordingFailed):
                raise broke_off(error, path) from error
            raise
        source.stop(hurry=False)
    return Recorded(decoder.statistics(), file.bytes_written, complete)


def _write_words(
    source: WordSource, file: RawWriter, decoder: Evt3Decoder, duration_s: float, watch: Watch
) -> bool:
    """Write until covered (True), or until stopped or at the stream's own end (False)."""
    wanted_us = duration_s * 1e6
    covered_us = -1
    deadline = 0.0
    while decoder.covered_us < wanted_us:
        if watch.stop_asked.is_set():
            return False
        if decoder.covered_us > covered_us:
            covered_us = decoder.covered_us
            deadline = watch.clock.monotonic() + watch.silence_s
        elif watch.clock.monotonic() > deadline:
            raise CameraLost(
                f"Its clock has not gone on for {watch.silence_s:g} s.",
                where=watch.where,
                remedy="Check the camera's cable and power (or its simulator), then resume the run.",
            )
        watch.clock.sleep(0.0)
        words = source.next_words()
        if words == b"":
            return False
        if words is not None:
            file.write(words)
            decoder.tally(np.frombuffer(words, "<u2"))
    return True


def broke_off(error: DriverError, path: Path) -> CameraError:
    """Build the error of a recording that broke off: what happened, and which file holds what came before."""
    kind = CameraLost if isinstance(error, CameraLost) else RecordingFailed
    what = f"{error.what} The recording broke off; what came before is in {path}."
    return kind(what, where=error.where, remedy=error.remedy)


def recording_facts(
    camera: CameraIdentity,
    recorded: Recorded,
    *,
    biases: Mapping[str, int],
    filters: Mapping[str, bool],
    temperature_c: float | None,
    illumination_lux: float | None,
    losses: Sequence[str] = (),
) -> RecordingFacts:
    """Put together what is known of a recording; ``losses`` are those that the driver itself noticed."""
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
        gaps=(*losses, *statistics.losses_in_words()),
        complete=recorded.complete,
    )
