"""The socket to a simulated EVK4: frames, requests and answers; knows nothing of biases or recordings.

A frame is one ASCII byte of type, its payload's length as a little-endian uint32, and the payload:
``Q`` a request (JSON, host to camera), ``A`` its answer (JSON), ``D`` EVT3 words, ``N`` a notification
(JSON).
"""

from __future__ import annotations

import json
import select
import socket
import struct
import threading
from collections.abc import Mapping
from typing import Any, Final, NamedTuple

from drivers.clock import Clock
from drivers.errors import CameraError, CameraLost, CameraNotFound, DeviceRefused, ReplyGarbled, ReplyTimeout

MAX_FRAME_BYTES: Final = 1 << 26
"""No frame of 2 ms comes near; a longer one is a peer that speaks another protocol."""

COMPUTING_S: Final = 600.0
"""So long an answer or the next words may take while the camera says that it computes: its first start on a busy
machine compiles its pixels."""

POLL_S: Final = 0.02
"""Longest wait for bytes between two safe points of the clock."""

_ONE_VERSION: Final = "See that a simulated EVK4 of this version listens at that address."

_HEAD: Final = struct.Struct("<cI")


class Frame(NamedTuple):
    """Type and payload."""

    kind: bytes
    payload: bytes


class Evk4Line:
    """One connection.

    Parameters
    ----------
    address
        ``host:port``.
    clock
        Deadlines count on it; every round of waiting passes through its ``sleep``.
    silence_s
        How long the camera may send nothing, while something is awaited of it, before it counts as lost. One that
        computes for longer says so meanwhile.
    """

    def __init__(self, address: str, *, clock: Clock, silence_s: float) -> None:
        self.address = address
        self._clock = clock
        self.silence_s = silence_s
        self._received = bytearray()
        self._last_id = 0
        self._heard_s = clock.monotonic()
        self._idle_s = 0.0
        self._sending = threading.Lock()
        self._socket = _connect(address, silence_s)

    def request(
        self, command: str, *, interruptible: bool = True, within_s: float | None = None, **parameters: Any
    ) -> Mapping[str, Any]:
        """Send a command and wait for its answer; words and late answers that come before it are dropped.

        Parameters
        ----------
        command, parameters
            What to ask.
        interruptible
            Whether the clock may end the wait.
        within_s
            Deadline; the bounds on silence and on computing when None.

        Raises
        ------
        DeviceRefused
            When the camera says no.
        ReplyTimeout, ReplyGarbled, CameraLost
            When it says nothing, nonsense, or has gone.
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
                raise ReplyTimeout(
                    f'It did not answer "{command}"; for {self.silent_s():.1f} s it has sent nothing.',
                    where=self._where,
                    remedy="Restart the simulated bench.",
                )

    def silent_s(self) -> float:
        """How long nothing has come, s, since something is awaited; polls count too, as a test's clock may stand."""
        return max(self._clock.monotonic() - self._heard_s, self._idle_s)

    def check_alive(self) -> None:
        """Raise CameraLost when nothing has come for too long."""
        if self.silent_s() > self.silence_s:
            raise self._lost(f"it has sent nothing for {self.silence_s:g} s")

    def receive(self) -> Frame | None:
        """Next answer or words, or None when none is complete after a short wait.

        Raises
        ------
        CameraError
            When the camera reports a fault of its own.
        CameraLost, ReplyGarbled
            When it has gone, or sends something else than frames.
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
        """Give the connection back."""
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
        """Note that something was heard, or is awaited, from now on."""
        self._heard_s, self._idle_s = self._clock.monotonic(), 0.0

    def _take_frame(self) -> Frame | None:
        if len(self._received) < _HEAD.size:
            return None
        kind, length = _HEAD.unpack_from(self._received)
        if kind not in (b"A", b"D", b"N") or length > MAX_FRAME_BYTES or (kind == b"D" and length % 2):
            raise ReplyGarbled(
                f"It sent something else than a frame: {bytes(self._received[:16])!r}.",
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
                f"An answer that is no JSON: {frame.payload[:80]!r}.", where=self._where, remedy=_ONE_VERSION
            ) from error
        if not isinstance(value, dict):
            raise ReplyGarbled(
                f"An answer that is no JSON object: {frame.payload[:80]!r}.",
                where=self._where,
                remedy=_ONE_VERSION,
            )
        return value

    def _checked_answer(self, command: str, answer: Mapping[str, Any]) -> Mapping[str, Any]:
        if answer.get("ok") is True:
            return answer
        reason = answer.get("message") or answer.get("error") or "it gives no reason"
        raise DeviceRefused(
            f'It refused "{command}": {reason}',
            where=self._where,
            remedy="Correct that setting, or restart the simulated bench.",
        )

    def _handle_notification(self, notification: Mapping[str, Any]) -> None:
        """Take a fault for what it is; that it computes is heard by its coming, and others are let pass."""
        if notification.get("event") == "fault":
            raise CameraError(
                f"It reports a fault: {notification.get('message', 'without saying which')}",
                where=self._where,
                remedy="Remove the cause, then record again.",
            )

    def _lost(self, how: str) -> CameraLost:
        return CameraLost(
            f"It has gone ({how}).", where=self._where, remedy="Start the simulated bench again, then resume."
        )


def _connect(address: str, timeout_s: float) -> socket.socket:
    """Connect to ``host:port``. Raises CameraNotFound."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise CameraNotFound(
            f"{address!r} is no address of a camera.",
            remedy='Write it as "host:port", e.g. "127.0.0.1:7000".',
        )
    try:
        connection = socket.create_connection((host, int(port)), timeout=min(timeout_s, 10.0))
    except OSError as error:
        raise CameraNotFound(
            f"No camera listens there ({error.strerror or error}).",
            where=f"camera at {address}",
            remedy="Start the simulated bench, or correct the address in the station file.",
        ) from error
    connection.settimeout(timeout_s)
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return connection
