"""The simulated EVK4 as a camera of the bench: knows its commands, and how a recording of it is made.

It records as a real camera's driver does: the camera's own words go to the file as they come; the decoder
only counts along, to know when the sensor's clock has covered the time asked for.
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
from drivers.camera.recording import StopConditions, check_duration, record_words, recording_facts, refuse_roi
from drivers.clock import Clock
from drivers.errors import (
    CameraSettingRefused,
    DeviceRefused,
    ReplyGarbled,
    WrongDevice,
)

BIASES: Final = ("bias_diff_on", "bias_diff_off", "bias_fo", "bias_hpf", "bias_refr")

SILENCE_S: Final = 4.0
"""One that computes for longer, on a busy machine, says so twice a second; one that has died closes the connection."""

STOP_S: Final = 5.0
"""Longest wait for the stream to stop when something else has gone wrong."""


class SimulatedEvk4Camera:
    """An ``EventCamera`` on a socket.

    Parameters
    ----------
    line
        The connection.
    serial
        The serial number it must have; None takes any.
    clock
        All waits pass through it.
    utc_now
        Tells the time that the header of a recording states.
    """

    def __init__(
        self, line: Evk4Line, *, serial: str | None, clock: Clock, utc_now: Callable[[], datetime]
    ) -> None:
        self._line = line
        self._serial = serial
        self._clock = clock
        self._utc_now = utc_now
        self._in_use = threading.RLock()
        self._stop_asked = threading.Event()

    @classmethod
    def open(
        cls,
        address: str,
        *,
        serial: str | None = None,
        clock: Clock,
        utc_now: Callable[[], datetime],
        silence_s: float = SILENCE_S,
    ) -> SimulatedEvk4Camera:
        """Connect and see that it is the right camera.

        Raises
        ------
        CameraNotFound
            When nothing listens at ``address`` (``host:port``).
        WrongDevice
            When it has another serial number.
        DriverError
            When it does not speak the protocol.
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
        """Ask who it is. Raises WrongDevice when the serial number differs from the given one."""
        answer = self._ask("identify")
        if (encoding := self._text(answer, "format")) != "EVT3":
            raise ReplyGarbled(
                f"It sends {encoding}, not EVT3.",
                where=self._where,
                remedy="See that simulator and driver are of one version.",
            )
        identity = CameraIdentity(
            maker=self._text(answer, "maker"),
            model=self._text(answer, "model"),
            sensor=self._text(answer, "sensor"),
            serial=self._text(answer, "serial"),
            firmware=self._text(answer, "firmware"),
            width=int(self._number(answer, "width")),
            height=int(self._number(answer, "height")),
        )
        if self._serial is not None and identity.serial != self._serial:
            raise WrongDevice(
                f"It is camera {identity.serial}, not {self._serial}.",
                where=self._where,
                remedy="Correct the address or the serial number in the station file.",
            )
        return identity

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set biases and trigger input, switch all filters off; return what was read back.

        Biases that are not named go back to their factory value, so that equal settings are equal states.

        Raises
        ------
        CameraSettingRefused
            When a value is refused, or another one is read back.
        """
        refuse_roi(settings, self._where)
        unknown = sorted(set(settings.biases) - set(BIASES))
        if unknown:
            raise CameraSettingRefused(
                f"It has no bias {', '.join(unknown)}.",
                where=self._where,
                remedy=f"Biases of this camera: {', '.join(BIASES)}.",
            )
        for name in BIASES:
            self._set("set_bias", name=name, value=settings.biases.get(name, 0))
        for name in self.filters():
            self._set("set_filter", name=name, enabled=False)
        self._set("set_trigger_in", enabled=settings.trigger_in)
        found = CameraSettings(self._biases(), self._flag(self._ask("get_trigger_in"), "enabled"))
        wanted = {name: settings.biases.get(name, 0) for name in BIASES}
        if dict(found.biases) != wanted or found.trigger_in != settings.trigger_in:
            raise CameraSettingRefused(
                f"It was set to {wanted}, trigger input {settings.trigger_in}, but reads back {found}.",
                where=self._where,
                remedy="Use values that it can hold.",
            )
        if left_on := [name for name, on in self.filters().items() if on]:
            raise CameraSettingRefused(
                f"Its filter {', '.join(left_on)} stays on.",
                where=self._where,
                remedy="A filter falsifies the recording: restart the camera.",
            )
        return found

    def filters(self) -> Mapping[str, bool]:
        """On-chip filters and whether each is on."""
        answer = self._ask("get_filters")
        return {name: self._flag(answer, name) for name in answer if name not in ("id", "ok")}

    def temperature_c(self) -> float | None:
        """Sensor temperature."""
        return self._number(self._ask("monitor"), "temperature_c")

    def record(self, path: Path, duration_s: float) -> RecordingFacts:
        """Record at least that long of the sensor's clock into a new RAW file; see ``EventCamera.record``.

        Raises
        ------
        RecordingFailed
            When the file cannot be made or written, or the words are malformed; what came before is kept.
        CameraLost
            When the camera goes away meanwhile; what came before is kept.
        """
        check_duration(duration_s, where=self._where)
        with self._in_use:
            self._stop_asked.clear()
            identity = self.identify()
            biases, filters, monitor = self._biases(), self.filters(), self._ask("monitor")
            recorded = record_words(
                _Stream(self._line),
                path,
                render_header(identity, self._utc_now()),
                (identity.width, identity.height),
                duration_s,
                StopConditions(self._clock, self._stop_asked, COMPUTING_S, self._where),
            )
        return recording_facts(
            identity,
            recorded,
            biases=biases,
            filters=filters,
            temperature_c=self._number(monitor, "temperature_c"),
            illumination_lux=self._number(monitor, "illumination_lux"),
        )

    def stop(self) -> None:
        """End a recording at the next words that come; callable from any thread."""
        self._stop_asked.set()

    def close(self) -> None:
        """Let the camera go: the connection is closed, and with it the stream."""
        self._line.close()

    # ------------------------------------------------------------- asking

    @property
    def _where(self) -> str:
        return f"camera at {self._line.address}"

    def _ask(self, command: str, **parameters: Any) -> Mapping[str, Any]:
        with self._in_use:
            return self._line.request(command, **parameters)

    def _set(self, command: str, **parameters: Any) -> None:
        """Set something. Raises CameraSettingRefused when the camera does not take it."""
        try:
            self._ask(command, **parameters)
        except DeviceRefused as error:
            raise CameraSettingRefused(
                error.what, where=self._where, remedy="Correct that setting in the station or sequence file."
            ) from error

    def _biases(self) -> dict[str, int]:
        answer = self._ask("get_biases")
        found = answer.get("biases")
        if not isinstance(found, dict):
            raise self._garbled("biases", answer)
        return {name: int(self._number(found, name)) for name in BIASES}

    def _text(self, answer: Mapping[str, Any], key: str) -> str:
        value = answer.get(key)
        if not isinstance(value, str):
            raise self._garbled(key, answer)
        return value

    def _number(self, answer: Mapping[str, Any], key: str) -> float:
        value = answer.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self._garbled(key, answer)
        return value

    def _flag(self, answer: Mapping[str, Any], key: str) -> bool:
        value = answer.get(key)
        if not isinstance(value, bool):
            raise self._garbled(key, answer)
        return value

    def _garbled(self, key: str, answer: Mapping[str, Any]) -> ReplyGarbled:
        return ReplyGarbled(
            f'Its answer tells no proper "{key}": {dict(answer)!r:.200}.',
            where=self._where,
            remedy="See that simulator and driver are of one version.",
        )


class _Stream:
    """The camera's words between start and stop."""

    def __init__(self, line: Evk4Line) -> None:
        self._line = line
        self._kept = 0

    def start(self) -> None:
        self._kept = 0
        self._line.request("start")

    def next_words(self) -> bytes | None:
        frame = self._line.receive()
        if frame is None:
            self._line.check_alive()
        if frame is None or frame.kind != b"D":
            return None
        self._kept += 1
        return frame.payload or None

    def stop(self, *, hurry: bool) -> None:
        """Stop it, and tell how much was kept: its clock goes on from there."""
        within_s = STOP_S if hurry else None
        self._line.request("stop", interruptible=False, within_s=within_s, frames=self._kept)
