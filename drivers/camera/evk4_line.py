"""The connection to a simulated EVK4: frames on a socket, answers, notifications, and silence.

A frame is one ASCII byte of type, its payload's length as a little-endian uint32, and the payload: ``Q`` a request
(JSON, host to camera), ``A`` its answer (JSON), ``D`` EVT3 words, ``N`` a notification (JSON).
docs/protocols/simulated-evk4.md describes the protocol.
"""

from __future__ import annotations

import json
import select
import socket
import struct
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Final, NamedTuple

from drivers.camera.recording import connection_lost
from drivers.clock import Clock
from drivers.errors import CameraError, CameraLost, CameraNotFound, DeviceRefused, ReplyGarbled, ReplyTimeout
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
    """One connection to a simulated EVK4 at ``host:port``.

    The clock's ``sleep`` is called in every round of waiting. A camera that sends nothing for ``silence_s`` while
    something is expected counts as lost; one that computes for longer reports so meanwhile.
    """

    def __init__(self, address: str, *, clock: Clock, silence_s: float) -> None:
        self.where = f"camera at {address}"
        self._address = address
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

        ``interruptible``: the clock may end the wait. ``within_s`` None stands for the limits on silence and on
        computing.
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
        """Measure the silence while something is expected, s, without what a busy computer took from either end.

        Polls count too, as a test's clock may stand still.
        """
        silent_s = max(self._clock.monotonic() - self._heard_s, self._idle_s)
        return max(0.0, silent_s - min(self._quiet.late_s(), MOST_STRETCH_S))

    def check_alive(self) -> None:
        """Raise `CameraLost` if nothing has come for ``silence_s``."""
        if self.silent_s() > self.silence_s:
            late_s = self._quiet.starved_s()
            how = f"it has sent nothing for {self.silence_s:g} s"
            raise self._lost(f"{how}; {busy_text(late_s)}", BUSY_REMEDY) if late_s else self._lost(how)

    def receive(self) -> Frame | None:
        """Wait shortly for the next answer or words, None if no frame is complete; raise the camera's own faults."""
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

    def garbled(self, what: str) -> ReplyGarbled:
        """Return the error of a peer that breaks the protocol."""
        return ReplyGarbled(what, where=self.where, remedy=_ONE_VERSION)

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
        self._quiet = Deadline(self.silence_s, self._address)

    def _take_frame(self) -> Frame | None:
        if len(self._received) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack_from(self._received)
        if kind not in (b"A", b"D", b"N") or length > MAX_FRAME_BYTES or (kind == b"D" and length % 2):
            raise self.garbled(f"The camera sent bytes that are no frame: {bytes(self._received[:16])!r}.")
        end = _HEAD.size + length
        if len(self._received) < end:
            return None
        payload = bytes(self._received[_HEAD.size : end])
        del self._received[:end]
        return Frame(kind, payload)

    def _json(self, frame: Frame) -> Mapping[str, Any]:
        value = None
        with suppress(ValueError, RecursionError):
            value = json.loads(frame.payload)
        if not isinstance(value, dict):
            raise self.garbled(f"The answer is no JSON object: {frame.payload[:80]!r}.")
        return value

    def _checked_answer(self, command: str, answer: Mapping[str, Any]) -> Mapping[str, Any]:
        if answer.get("ok") is True:
            return answer
        reason = answer.get("message") or answer.get("error") or "it gives no reason"
        raise DeviceRefused(
            f'The camera refused "{command}": {reason}',
            where=self.where,
            remedy="Correct that setting.",
        )

    def _handle_notification(self, notification: Mapping[str, Any]) -> None:
        """Raise a reported fault. "Computing" needs no action beyond having arrived; others are ignored."""
        if notification.get("event") == "fault":
            raise CameraError(
                f"The camera reports a fault: {notification.get('message', 'no description')}",
                where=self.where,
                remedy="Remove the cause, then record again.",
            )

    def _no_answer(self, command: str) -> ReplyTimeout:
        late_s = self._quiet.starved_s()
        what = f'The camera did not answer "{command}"; it has sent nothing for {self.silent_s():.1f} s'
        return ReplyTimeout(
            f"{what}, and {busy_text(late_s)}." if late_s else f"{what}.",
            where=self.where,
            remedy=BUSY_REMEDY if late_s else _START_AGAIN,
            late_s=late_s,
        )

    def _lost(self, how: str, remedy: str = _START_AGAIN) -> CameraLost:
        return connection_lost(how, self.where, remedy)


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
