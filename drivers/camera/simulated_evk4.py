"""Driver of the simulated EVK4: its commands, and recording from it.

It records as the driver of a real camera does: the camera's own words go to the file as they come. The decoder only
counts along, to find when the sensor's clock has covered the duration.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.evk4_line import COMPUTING_S, Evk4Line
from drivers.camera.raw_header import render_header
from drivers.camera.recording import (
    BIASES,
    EventCameraDriver,
    recording_facts,
    refuse_filters,
    refuse_roi,
    refuse_unknown_biases,
)
from drivers.clock import Clock
from drivers.errors import CameraSettingRefused, DeviceRefused, ReplyGarbled

LONGEST_SILENCE_S: Final = 4.0
"""Longest silence, s. A camera that computes for longer reports so twice a second; one that has died closes the
connection."""

STOP_S: Final = 5.0
"""Longest wait for the stream to stop after something else has failed, s."""


class SimulatedEvk4Camera(EventCameraDriver):
    """An ``EventCamera`` on a socket; ``serial`` None accepts any camera, ``utc_now`` is for a recording's header."""

    SILENCE_S = COMPUTING_S
    OTHER_CAMERA_REMEDY = "Correct the address or the serial number in the station file."

    def __init__(
        self, line: Evk4Line, *, serial: str | None, clock: Clock, utc_now: Callable[[], datetime]
    ) -> None:
        super().__init__(serial=serial, clock=clock)
        self._line = line
        self._utc_now = utc_now
        self._in_use = threading.RLock()

    @classmethod
    def open(
        cls,
        address: str,
        *,
        serial: str | None = None,
        clock: Clock,
        utc_now: Callable[[], datetime],
        silence_s: float = LONGEST_SILENCE_S,
    ) -> SimulatedEvk4Camera:
        """Connect to ``host:port``, and check that it is the right camera; ``serial`` None accepts any.

        After ``silence_s`` the camera counts as lost. Raises `CameraNotFound` if nothing listens at the address,
        `DriverError` if the peer does not follow the protocol.
        """
        line = Evk4Line(address, clock=clock, silence_s=silence_s)
        camera = cls(line, serial=serial, clock=clock, utc_now=utc_now)
        try:
            camera.identify()
        except BaseException:
            line.close()
            raise
        return camera

    def identify(self) -> CameraIdentity:
        """Read the camera's identity; refuse another serial number than at opening, a missing field, or no EVT3."""
        answer = self._ask("identify")
        if (encoding := self._value(answer, "format", str)) != "EVT3":
            raise self._line.garbled(f"The camera sends {encoding}, not EVT3.")
        identity = CameraIdentity(
            maker=self._value(answer, "maker", str),
            model=self._value(answer, "model", str),
            sensor=self._value(answer, "sensor", str),
            serial=self._value(answer, "serial", str),
            firmware=self._value(answer, "firmware", str),
            width=int(self._number(answer, "width")),
            height=int(self._number(answer, "height")),
        )
        return self._require_serial(identity)

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set biases and trigger input, read them back, and switch all filters off; see `EventCamera.apply`."""
        refuse_roi(settings, self._where)
        refuse_unknown_biases(settings, BIASES, self._where)
        for name in BIASES:
            self._set("set_bias", name=name, value=settings.biases.get(name, 0))
        for name in self.filters():
            self._set("set_filter", name=name, enabled=False)
        self._set("set_trigger_in", enabled=settings.trigger_in)
        present = CameraSettings(self._biases(), self._value(self._ask("get_trigger_in"), "enabled", bool))
        wanted = {name: settings.biases.get(name, 0) for name in BIASES}
        if dict(present.biases) != wanted or present.trigger_in != settings.trigger_in:
            raise CameraSettingRefused(
                f"The camera was set to {wanted}, trigger input {settings.trigger_in}, but reads back {present}.",
                where=self._where,
                remedy="Use values that the camera can represent.",
            )
        refuse_filters(self.filters(), self._where)
        return present

    def filters(self) -> Mapping[str, bool]:
        """See `EventCamera.filters`."""
        answer = self._ask("get_filters")
        return {name: self._value(answer, name, bool) for name in answer if name not in ("id", "ok")}

    def temperature_c(self) -> float | None:
        """See `EventCamera.temperature_c`."""
        return self._number(self._ask("monitor"), "temperature_c")

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """See `EventCamera.record`."""
        return self._record(path, duration_s, preview=False)

    def preview(self, path: Path, duration_s: float) -> RecordingFacts:
        """See `PreviewCamera.preview`."""
        return self._record(path, duration_s, preview=True)

    def _record(self, path: Path, duration_s: float, *, preview: bool) -> RecordingFacts:
        with self._in_use:
            self._begin(duration_s)
            identity = self.identify()
            biases, filters, monitor = self._biases(), self.filters(), self._ask("monitor")
            header, size = render_header(identity, self._utc_now()), (identity.width, identity.height)
            recorded = self.record_words(_Stream(self._line, preview=preview), path, header, size, duration_s)
        return recording_facts(
            identity,
            recorded,
            biases=biases,
            filters=filters,
            temperature_c=self._number(monitor, "temperature_c"),
            illumination_lux=self._number(monitor, "illumination_lux"),
        )

    def close(self) -> None:
        """Close the connection, which also ends the stream."""
        self._line.close()

    # ------------------------------------------------------------- requests

    @property
    def _where(self) -> str:
        return self._line.where

    def _ask(self, command: str, **parameters: Any) -> Mapping[str, Any]:
        with self._in_use:
            return self._line.request(command, **parameters)

    def _set(self, command: str, **parameters: Any) -> None:
        """Change a setting. Raises CameraSettingRefused if the camera refuses it."""
        try:
            self._ask(command, **parameters)
        except DeviceRefused as error:
            raise CameraSettingRefused(
                error.what, where=self._where, remedy="Correct that setting in the station or sequence file."
            ) from error

    def _biases(self) -> dict[str, int]:
        answer = self._ask("get_biases")
        biases = answer.get("biases")
        if not isinstance(biases, dict):
            raise self._garbled("biases", answer)
        return {name: int(self._number(biases, name)) for name in BIASES}

    def _value(self, answer: Mapping[str, Any], key: str, *kinds: type) -> Any:
        """Return a value of an answer; it has one of the types, and is finite. Raises ReplyGarbled."""
        value = answer.get(key)
        if type(value) not in kinds or (isinstance(value, float) and not math.isfinite(value)):
            raise self._garbled(key, answer)
        return value

    def _number(self, answer: Mapping[str, Any], key: str) -> float:
        number: float = self._value(answer, key, int, float)
        return number

    def _garbled(self, key: str, answer: Mapping[str, Any]) -> ReplyGarbled:
        return self._line.garbled(f'The answer holds no valid "{key}": {dict(answer)!r:.200}.')


class _Stream:
    """The camera's words between start and stop."""

    def __init__(self, line: Evk4Line, *, preview: bool) -> None:
        self._line = line
        self._asked = {"preview": True} if preview else {}
        self._kept = 0

    def start(self) -> None:
        self._kept = 0
        self._line.request("start", **self._asked)

    def next_words(self) -> bytes | None:
        frame = self._line.receive()
        if frame is None:
            self._line.check_alive()
        if frame is None or frame.kind != b"D":
            return None
        self._kept += 1
        return frame.payload or None

    def stop(self, *, hurry: bool) -> None:
        """Stop the stream, and report how many frames were kept: the simulated clock continues from there."""
        within_s = STOP_S if hurry else None
        self._line.request("stop", interruptible=False, within_s=within_s, frames=self._kept)
