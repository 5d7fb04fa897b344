"""Recordings played as a camera: a folder of RAW files, one for each recording asked for, or one long RAW file.

Knows the files alone; what it hands on are their own words and header. The files of a folder are played whole;
from one long file, recordings are taken one after the other, each beginning at a TIME_HIGH word. Nothing can be
set: what was set when the files were recorded is in them.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.evt3 import first_time_high
from drivers.camera.raw_file import RawFile
from drivers.camera.recording import StopConditions, check_duration, record_words, recording_facts, refuse_roi
from drivers.clock import Clock
from drivers.errors import CameraNotFound, CameraSettingRefused, RecordingFailed, WrongDevice

_PIECE_WORDS: Final = 1024
_SILENCE_S: Final = 10.0


class RecordedCamera:
    """An ``EventCamera`` that plays RAW files.

    Parameters
    ----------
    files
        What to play, in this order.
    serial
        The serial number that their headers must have; None takes any.
    clock
        All waits pass through it.
    """

    def __init__(self, files: list[RawFile], *, serial: str | None, clock: Clock) -> None:
        self._files = files
        self._serial = serial
        self._clock = clock
        self._stop_asked = threading.Event()
        self._played = 0
        self._player = _Player(files[0]) if len(files) == 1 else None

    @classmethod
    def open(cls, path: Path | str, *, serial: str | None = None, clock: Clock) -> RecordedCamera:
        """Open a RAW file, or all ``*.raw`` of a folder in the order of their names.

        Raises
        ------
        CameraNotFound
            When there is nothing to play.
        WrongDevice
            When a file is of another camera.
        RecordingFileError
            When a file cannot be read, or is no RAW recording of EVT3.
        """
        path = Path(path)
        paths = sorted(path.glob("*.raw")) if path.is_dir() else [path]
        if not paths:
            raise CameraNotFound(
                "No RAW file to play is in this folder.",
                where=str(path),
                remedy="Name a folder with *.raw files.",
            )
        camera = cls([RawFile.open(file) for file in paths], serial=serial, clock=clock)
        camera.identify()
        return camera

    def identify(self) -> CameraIdentity:
        """Say who recorded the files. Raises WrongDevice when one of them is of another camera."""
        first = self._files[0]
        wanted = first.serial if self._serial is None else self._serial
        for file in self._files:
            if file.serial != wanted:
                raise WrongDevice(
                    f"It was recorded by camera {file.serial or 'without number'}, not {wanted or 'without number'}.",
                    where=str(file.path),
                    remedy="Correct the serial number in the station file, or take that file away.",
                )
        header = first.header
        return CameraIdentity(
            maker=header.get("integrator_name", header.get("camera_integrator_name", "")),
            model="recorded",
            sensor=header.get("sensor_name", ""),
            serial=first.serial,
            firmware="",
            width=first.width,
            height=first.height,
        )

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Take settings that change nothing. Raises CameraSettingRefused for a bias: it cannot be set any more."""
        refuse_roi(settings, self._where)
        if changed := sorted(name for name, value in settings.biases.items() if value):
            raise CameraSettingRefused(
                f"The {', '.join(changed)} of a recording cannot be changed any more.",
                where=self._where,
                remedy="Leave the biases out of the station file.",
            )
        return CameraSettings({}, settings.trigger_in)

    def filters(self) -> Mapping[str, bool]:
        """Nothing: a RAW file does not say which filters were on."""
        return {}

    def temperature_c(self) -> float | None:
        """Nothing: a RAW file does not tell."""
        return None

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Play the next recording into a new RAW file; it is not complete when it is shorter than asked for.

        Raises
        ------
        RecordingFailed
            When all has been played, the file cannot be made or written, or the words are malformed.
        """
        check_duration(duration_s, where=self._where)
        self._stop_asked.clear()
        source = self._next_source()
        recorded = record_words(
            source,
            path,
            source.file.raw_header.text,
            (source.file.width, source.file.height),
            math.inf if self._player is None else duration_s,
            StopConditions(self._clock, self._stop_asked, _SILENCE_S, self._where),
        )
        self._played += 1
        complete = recorded.statistics.duration_s >= duration_s and not self._stop_asked.is_set()
        return recording_facts(
            self.identify(),
            replace(recorded, complete=complete),
            biases={},
            filters={},
            temperature_c=None,
            illumination_lux=None,
        )

    def stop(self) -> None:
        """End a recording early; callable from any thread."""
        self._stop_asked.set()

    def close(self) -> None:
        """Nothing is held open."""

    @property
    def _where(self) -> str:
        return str(self._files[0].path if len(self._files) == 1 else self._files[0].path.parent)

    def _next_source(self) -> _Player:
        if self._player is not None and not self._player.at_end():
            return self._player
        if self._player is None and self._played < len(self._files):
            return _Player(self._files[self._played])
        raise RecordingFailed(
            f"All that was recorded has been played ({self._played} recordings taken).",
            where=self._where,
            remedy="Ask for fewer or shorter recordings, or play more files.",
        )


class _Player:
    """The words of one file, taken piece by piece, from where they were left."""

    def __init__(self, file: RawFile) -> None:
        self.file = file
        self._pieces = file.words(piece_words=_PIECE_WORDS)
        self._ahead = next(self._pieces, None)
        self._begun = False

    def at_end(self) -> bool:
        return self._ahead is None

    def start(self) -> None:
        self._begun = False

    def next_words(self) -> bytes | None:
        piece, self._ahead = self._ahead, next(self._pieces, None)
        if piece is None:
            return b""
        start = 0 if self._begun else first_time_high(piece)
        if start is None:
            return None
        self._begun = True
        return piece[start:].tobytes() or None

    def stop(self, *, hurry: bool) -> None:
        """Leave the rest for the next recording."""
