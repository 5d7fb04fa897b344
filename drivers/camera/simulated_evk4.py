"""Driver of the simulated EVK4: its connection, its commands, and recording from it.

It records as the driver of a real camera does: the camera's own words go to the file as they come. The decoder only
counts along, to find when the sensor's clock has covered the duration.

The camera is reached by a socket. A frame is one ASCII byte of type, its payload's length as a little-endian uint32,
and the payload: ``Q`` a request (JSON, host to camera), ``A`` its answer (JSON), ``D`` EVT3 words, ``N`` a notification
(JSON). The protocol is described in docs/protocols/simulated-evk4.md.
"""

from __future__ import annotations

import json
import math
import select
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any, Final, NamedTuple

from drivers.camera import CameraIdentity, CameraSettings, RecordingFacts
from drivers.camera.raw_header import render_header
from drivers.camera.recording import (
    BIASES,
    StopConditions,
    check_duration,
    record_words,
    recording_facts,
    refuse_roi,
    refuse_unknown_biases,
)
from drivers.clock import Clock
from drivers.errors import (
    CameraError,
    CameraLost,
    CameraNotFound,
    CameraSettingRefused,
    DeviceRefused,
    ReplyGarbled,
    ReplyTimeout,
    WrongDevice,
)
from drivers.lateness import MOST_STRETCH_S, Deadline, busy_text
from drivers.lateness import REMEDY as BUSY_REMEDY

MAX_FRAME_BYTES: Final = 1 << 26
"""Largest payload. No frame of 2 ms comes near it; a longer one comes from a peer that uses another protocol."""

COMPUTING_S: Final = 600.0
"""Longest wait for an answer or the next words while the camera reports that it computes: at its first start on a busy
computer it compiles its pixel model."""

POLL_S: Final = 0.02
"""Longest wait for bytes between two calls of the clock's ``sleep``, s."""

_START_AGAIN: Final = (
    "Resume the run. A simulated bench that was started separately must be started again first."
)
_ONE_VERSION: Final = "Check that a simulated EVK4 of this version of Starbench listens at that address."

_HEAD: Final = struct.Struct("<cI")


class Frame(NamedTuple):
    """One frame."""

    kind: bytes
    payload: bytes  # The bytes after the length


class Evk4Line:
    """One connection to a simulated EVK4.

    address: ``host:port``.
    clock: Deadlines count on it; its ``sleep`` is called in every round of waiting.
    silence_s: How long the camera may send nothing while something is expected, s; after that it counts as
      lost. A camera that computes for longer reports so meanwhile.
    """

    def __init__(self, address: str, *, clock: Clock, silence_s: float) -> None:
        self.address = address
        self._clock = clock
        self.silence_s = silence_s
        self._received = bytearray()
        self._last_id = 0
        self._heard_s = clock.monotonic()
        self._idle_s = 0.0
        self._quiet = Deadline(silence_s, address)
        self._sending = threading.Lock()
        self._socket = _connect(address, silence_s)

    def request(
        self, command: str, *, interruptible: bool = True, within_s: float | None = None, **parameters: Any
    ) -> Mapping[str, Any]:
        """Send a command and wait for its answer. Words and late answers that arrive before it are dropped.

        interruptible: Whether the clock may end the wait.
        within_s: Deadline, s; None for the limits on silence and on computing.
        Raises DeviceRefused: If the camera refuses the command.
        Raises ReplyTimeout: If no answer comes in time.
        Raises ReplyGarbled: If the camera sends something that is no frame or no JSON.
        Raises CameraLost: If the connection is lost.
        """
        number = self._send(command, parameters)
        deadline = self._clock.monotonic() + (COMPUTING_S if within_s is None else within_s)
        silence_s = self.silence_s if within_s is None else min(within_s, self.silence_s)
        while True:
            if interruptible:
                self._clock.sleep(0.0)
            frame = self.receive()
            if frame is not None and frame.kind == b"A":
                answer = self._json(frame)
                if answer.get("id") == number:
                    return self._checked_answer(command, answer)
            if self.silent_s() > silence_s or self._clock.monotonic() > deadline:
                raise self._no_answer(command)

    def silent_s(self) -> float:
        """Measure the silence while something is expected. Polls count too, as a test's clock may stand still.

        Returns: Time, s, without the time that a busy computer did not let the camera or this process use.
        """
        silent_s = max(self._clock.monotonic() - self._heard_s, self._idle_s)
        return max(0.0, silent_s - min(self._quiet.late_s(), MOST_STRETCH_S))

    def check_alive(self) -> None:
        """Check that the camera still sends.

        Raises CameraLost: If nothing has come for ``silence_s``.
        """
        if self.silent_s() > self.silence_s:
            late_s = self._quiet.starved_s()
            how = f"it has sent nothing for {self.silence_s:g} s"
            raise self._lost(f"{how}; {busy_text(late_s)}" if late_s else how, busy=late_s > 0)

    def receive(self) -> Frame | None:
        """Wait a short time for the next frame.

        Returns: An answer or words; None if no frame is complete yet.
        Raises CameraError: If the camera reports a fault of its own.
        Raises CameraLost: If the connection is lost.
        Raises ReplyGarbled: If the camera sends something that is no frame.
        """
        frame = self._take_frame()
        if frame is None:
            ready, _, _ = select.select([self._socket], [], [], POLL_S)
            if ready:
                self._read_some()
            else:
                self._idle_s += POLL_S
            frame = self._take_frame()
        if frame is not None and frame.kind == b"N":
            self._handle_notification(self._json(frame))
            return None
        return frame

    def close(self) -> None:
        """Close the connection."""
        self._socket.close()

    @property
    def _where(self) -> str:
        return f"camera at {self.address}"

    def _send(self, command: str, parameters: Mapping[str, Any]) -> int:
        self._last_id += 1
        self._restart_silence()
        payload = json.dumps({"id": self._last_id, "cmd": command, **parameters}).encode()
        try:
            with self._sending:
                self._socket.sendall(_HEAD.pack(b"Q", len(payload)) + payload)
        except OSError as error:
            raise self._lost(str(error)) from error
        return self._last_id

    def _read_some(self) -> None:
        try:
            data = self._socket.recv(1 << 20)
        except OSError as error:
            raise self._lost(str(error)) from error
        if not data:
            raise self._lost("it closed the connection")
        self._received += data
        self._restart_silence()

    def _restart_silence(self) -> None:
        """Measure the silence from now on, because something was received or is expected."""
        self._heard_s, self._idle_s = self._clock.monotonic(), 0.0
        self._quiet = Deadline(self.silence_s, self.address)

    def _take_frame(self) -> Frame | None:
        if len(self._received) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack_from(self._received)
        if kind not in (b"A", b"D", b"N") or length > MAX_FRAME_BYTES or (kind == b"D" and length % 2):
            raise ReplyGarbled(
                f"The camera sent bytes that are no frame: {bytes(self._received[:16])!r}.",
                where=self._where,
                remedy=_ONE_VERSION,
            )
        end = _HEAD.size + length
        if len(self._received) < end:
            return None
        payload = bytes(self._received[_HEAD.size : end])
        del self._received[:end]
        return Frame(kind, payload)

    def _json(self, frame: Frame) -> Mapping[str, Any]:
        try:
            value = json.loads(frame.payload)
        except (ValueError, RecursionError) as error:
            raise ReplyGarbled(
                f"The answer is no JSON: {frame.payload[:80]!r}.", where=self._where, remedy=_ONE_VERSION
            ) from error
        if not isinstance(value, dict):
            raise ReplyGarbled(
                f"The answer is no JSON object: {frame.payload[:80]!r}.",
                where=self._where,
                remedy=_ONE_VERSION,
            )
        return value

    def _checked_answer(self, command: str, answer: Mapping[str, Any]) -> Mapping[str, Any]:
        if answer.get("ok") is True:
            return answer
        reason = answer.get("message") or answer.get("error") or "it gives no reason"
        raise DeviceRefused(
            f'The camera refused "{command}": {reason}',
            where=self._where,
            remedy="Correct that setting.",
        )

    def _handle_notification(self, notification: Mapping[str, Any]) -> None:
        """Raise a reported fault. "Computing" needs no action beyond having arrived; others are ignored."""
        if notification.get("event") == "fault":
            raise CameraError(
                f"The camera reports a fault: {notification.get('message', 'no description')}",
                where=self._where,
                remedy="Remove the cause, then record again.",
            )

    def _no_answer(self, command: str) -> ReplyTimeout:
        late_s = self._quiet.starved_s()
        what = f'The camera did not answer "{command}"; it has sent nothing for {self.silent_s():.1f} s'
        if late_s:
            return ReplyTimeout(
                f"{what}, and {busy_text(late_s)}.", where=self._where, remedy=BUSY_REMEDY, late_s=late_s
            )
        return ReplyTimeout(f"{what}.", where=self._where, remedy=_START_AGAIN)

    def _lost(self, how: str, *, busy: bool = False) -> CameraLost:
        return CameraLost(
            f"The connection to the camera is lost ({how}).",
            where=self._where,
            remedy=BUSY_REMEDY if busy else _START_AGAIN,
        )


def _connect(address: str, timeout_s: float) -> socket.socket:
    """Connect to ``host:port``. Raises CameraNotFound."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CameraNotFound(
            f"{address!r} is not a camera address.",
            remedy='Write the address as "host:port", e.g. "127.0.0.1:7000".',
        )
    try:
        connection = socket.create_connection((host, int(port)), timeout=min(timeout_s, 10.0))
    except OSError as error:
        raise CameraNotFound(
            f"No camera listens at this address ({error.strerror or error}).",
            where=f"camera at {address}",
            remedy="Start the simulated bench, or correct the address in the station file.",
        ) from error
    connection.settimeout(timeout_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection


SILENCE_S: Final = 4.0
"""Longest silence, s. A camera that computes for longer reports so twice a second; one that has died closes the
connection."""

STOP_S: Final = 5.0
"""Longest wait for the stream to stop after something else has failed, s."""


class SimulatedEvk4Camera:
    """An ``EventCamera`` on a socket.

    serial: The serial number that the camera must have; None accepts any.
    utc_now: Returns the time for the header of a recording.
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
        """Connect, and check that it is the right camera.

        address: ``host:port``.
        serial: The serial number that the camera must have; None accepts any.
        utc_now: Returns the time for the header of a recording.
        silence_s: Longest silence before the camera counts as lost, s.
        Raises CameraNotFound: If nothing listens at the address.
        Raises WrongDevice: If the camera has another serial number.
        Raises DriverError: If the peer does not follow the protocol.
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
        """Read the camera's identity.

        Raises WrongDevice: If the serial number differs from the one given when the camera was opened.
        Raises ReplyGarbled: If the answer lacks a field, or the camera does not send EVT3.
        """
        answer = self._ask("identify")
        if (encoding := self._value(answer, "format", str)) != "EVT3":
            raise ReplyGarbled(
                f"The camera sends {encoding}, not EVT3.",
                where=self._where,
                remedy="Use a simulator of the same version as Starbench.",
            )
        identity = CameraIdentity(
            maker=self._value(answer, "maker", str),
            model=self._value(answer, "model", str),
            sensor=self._value(answer, "sensor", str),
            serial=self._value(answer, "serial", str),
            firmware=self._value(answer, "firmware", str),
            width=int(self._number(answer, "width")),
            height=int(self._number(answer, "height")),
        )
        if self._serial is not None and identity.serial != self._serial:
            raise WrongDevice(
                f"This is camera {identity.serial}, not {self._serial}.",
                where=self._where,
                remedy="Correct the address or the serial number in the station file.",
            )
        return identity

    def apply(self, settings: CameraSettings) -> CameraSettings:
        """Set biases and trigger input, and switch all filters off; see `EventCamera.apply`.

        Raises CameraSettingRefused: If a value is refused, or another one is read back.
        """
        refuse_roi(settings, self._where)
        refuse_unknown_biases(settings, BIASES, self._where)
        for name in BIASES:
            self._set("set_bias", name=name, value=settings.biases.get(name, 0))
        for name in self.filters():
            self._set("set_filter", name=name, enabled=False)
        self._set("set_trigger_in", enabled=settings.trigger_in)
        found = CameraSettings(self._biases(), self._value(self._ask("get_trigger_in"), "enabled", bool))
        wanted = {name: settings.biases.get(name, 0) for name in BIASES}
        if dict(found.biases) != wanted or found.trigger_in != settings.trigger_in:
            raise CameraSettingRefused(
                f"The camera was set to {wanted}, trigger input {settings.trigger_in}, but reads back {found}.",
                where=self._where,
                remedy="Use values that the camera can represent.",
            )
        if left_on := [name for name, on in self.filters().items() if on]:
            raise CameraSettingRefused(
                f"The on-chip filters {', '.join(left_on)} could not be switched off.",
                where=self._where,
                remedy="Restart the camera; a filter falsifies the recording.",
            )
        return found

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
        check_duration(duration_s, where=self._where)
        with self._in_use:
            self._stop_asked.clear()
            identity = self.identify()
            biases, filters, monitor = self._biases(), self.filters(), self._ask("monitor")
            recorded = record_words(
                _Stream(self._line, preview=preview),
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
        """End a recording at the next words that come. Callable from any thread."""
        self._stop_asked.set()

    def close(self) -> None:
        """Close the connection, which also ends the stream."""
        self._line.close()

    # ------------------------------------------------------------- requests

    @property
    def _where(self) -> str:
        return f"camera at {self._line.address}"

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
        found = answer.get("biases")
        if not isinstance(found, dict):
            raise self._garbled("biases", answer)
        return {name: int(self._number(found, name)) for name in BIASES}

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
        return ReplyGarbled(
            f'The answer holds no valid "{key}": {dict(answer)!r:.200}.',
            where=self._where,
            remedy="Use a simulator of the same version as Starbench.",
        )


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
