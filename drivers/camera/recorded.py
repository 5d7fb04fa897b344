"""Play recordings as a camera: a folder of RAW files, one for each recording requested, or one long RAW file.

The camera hands on the files' own words and headers. The files of a folder are played whole. From one long file,
recordings are taken one after the other, each beginning at a TIME_HIGH word. No setting can be changed: the files
hold the effect of the settings with which they were recorded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.evt3 import first_time_high
from drivers.camera.raw_file import RawFile
from drivers.camera.recording import EventCameraDriver, recording_facts, refuse_roi
from drivers.clock import Clock
from drivers.errors import CameraNotFound, CameraSettingRefused, RecordingFailed, WrongDevice
from drivers.serial_number import is_same_serial

_PIECE_WORDS: Final = 1024  # Small, so that a recording ends near its duration


class RecordedCamera(EventCameraDriver):
    """An ``EventCamera`` that plays RAW files in the order given; ``serial`` None accepts any in their headers."""

    SILENCE_S = 10.0  # Twice that of a camera: a disk may have to start first

    def __init__(self, files: list[RawFile], *, serial: str | None, clock: Clock) -> None:
        super().__init__(serial=serial, clock=clock)
        self._files = files
        self._played = 0
        self._player = _Player(files[0]) if len(files) == 1 else None

    @classmethod
    def open(cls, path: Path | str, *, serial: str | None = None, clock: Clock) -> RecordedCamera:
        """Open a RAW file, or all ``*.raw`` of a folder in the order of their names; ``serial`` None accepts any.

        Raises `WrongDevice` if a file was recorded by another camera.
        """
        path = Path(path)
        paths = sorted(path.glob("*.raw")) if path.is_dir() else [path]
        if not paths:
            raise CameraNotFound(
                "This folder holds no RAW file.",
                where=str(path),
                remedy="Give a folder with *.raw files.",
            )
        camera = cls([RawFile.open(file) for file in paths], serial=serial, clock=clock)
        camera.identify()
        return camera

    def identify(self) -> CameraIdentity:
        """Return the identity of the camera in the header of the first file, with the model "recorded".

        Raises `WrongDevice` if a file was recorded by another camera.
        """
        first = self._files[0]
        wanted = first.serial if self._serial is None else self._serial
        for file in self._files:
            if not is_same_serial(file.serial, wanted):
                raise WrongDevice(
                    f"This file was recorded by camera {file.serial or 'without serial number'}, "
                    f"not {wanted or 'without serial number'}.",
                    where=str(file.path),
                    remedy="Correct the serial number in the station file, or remove this file from the folder.",
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
        """Accept settings that change nothing; refuse a bias other than 0, or a region of interest."""
        refuse_roi(settings, self._where)
        if changed := sorted(name for name, value in settings.biases.items() if value):
            raise CameraSettingRefused(
                f"The biases {', '.join(changed)} of a recording cannot be changed.",
                where=self._where,
                remedy="Leave the biases out of the station file.",
            )
        return CameraSettings({}, settings.trigger_in)

    def filters(self) -> Mapping[str, bool]:
        """Return nothing: a RAW file does not state which filters were on."""
        return {}

    def temperature_c(self) -> float | None:
        """Return None: a RAW file does not state the temperature."""
        return None

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Play the next recording into a new RAW file for ``duration_s`` on the sensor's clock.

        It is not ``complete`` if it is shorter than wanted. Raises `RecordingFailed` if all has been played, the file
        cannot be made or written, or the words are malformed.
        """
        self._begin(duration_s)
        source = self._next_source()
        header = source.file.raw_header
        play_s = math.inf if self._player is None else duration_s
        recorded = self.record_words(source, path, header.text, (header.width, header.height), play_s)
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

    def close(self) -> None:
        """Do nothing: no file stays open."""

    @property
    def _where(self) -> str:
        return str(self._files[0].path if len(self._files) == 1 else self._files[0].path.parent)

    def _next_source(self) -> _Player:
        if self._player is not None and not self._player.at_end():
            return self._player
        if self._player is None and self._played < len(self._files):
            return _Player(self._files[self._played])
        raise RecordingFailed(
            f"All recordings have been played ({self._played} taken).",
            where=self._where,
            remedy="Request fewer or shorter recordings, or provide more files.",
        )


class _Player:
    """The words of one file, taken piece by piece, each recording from where the one before ended."""

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
        """Do nothing: the rest is left for the next recording."""
