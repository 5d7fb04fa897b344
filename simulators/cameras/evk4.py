"""The simulated EVK4: it answers commands on a TCP socket and streams EVT3 words.

``docs/protocols/simulated-evk4.md`` defines the wire protocol and its error codes. This module handles connections,
commands and settings; `sensor_stream` produces the EVT3 words. One host at a time holds the camera. A second host gets
a fault notification, and its connection is closed.
"""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any, Final

from simulators.cameras.streaming import CameraServer, KeepAlive, StreamFaults, TimeBase
from simulators.errors import SimulatorError
from simulators.optics.lens_focus import brightness
from simulators.pixels.biases import ALLOWED, FACTORY, FILTERS, PixelSettings
from simulators.pixels.sensor_stream import CameraState, SensorStream
from simulators.world.world import World

HEADER: Final = struct.Struct("<cI")
"""Frame header: type (one ASCII letter) and payload length in bytes."""
MAX_REQUEST_BYTES: Final = 65536  # Requests have some hundred bytes
FIRMWARE: Final = "4.2.0-simulated"
NOMINAL_LUX: Final = 250.0
"""Illumination of the sensor at nominal brightness, lux; own choice, only the camera's light meter tells it."""
MEAN_COVERAGE: Final = 0.5
"""Share of the target that lets light through: half of each star is black."""
LEAVING_S: Final = 1.0
"""Time within which the camera notices that a host which has closed its connection is gone, s."""


class Refusal(Exception):
    """A refused command; ``code`` is an error code of the protocol, e.g. ``bad_value``."""

    def __init__(self, code: str, message: str) -> None:
        self.code = code
        super().__init__(message)


def parse_request(payload: bytes) -> dict[str, Any]:
    """Parse the payload of a request; refuse (``bad_request``) what is not a JSON object."""
    try:
        request = json.loads(payload)
    except (ValueError, RecursionError) as error:
        raise Refusal("bad_request", f"The request is no JSON: {error}.") from error
    if not isinstance(request, dict):
        raise Refusal("bad_request", "The request is no JSON object.")
    return request


def read_name(what: str, name: object, known: Mapping[str, Any]) -> str:
    """Check that a request names a known ``command``, ``bias`` or ``filter``; else refuse (``unknown_command`` ...)."""
    if not isinstance(name, str) or name not in known:
        raise Refusal(f"unknown_{what}", f"There is no {what} {name!r}; there are {', '.join(known)}.")
    return name


def read_enabled(request: Mapping[str, Any]) -> bool:
    """Read ``enabled`` from a request; refuse (``bad_value``) what is not a boolean."""
    enabled = request.get("enabled")
    if not isinstance(enabled, bool):
        raise Refusal("bad_value", f'"enabled" is true or false, not {enabled!r}.')
    return enabled


def read_frames(request: Mapping[str, Any]) -> int | None:
    """Read how many frames the host has kept, a whole number from 0 on; refuse (``bad_value``) anything else."""
    frames = request.get("frames")
    if frames is not None and (isinstance(frames, bool) or not isinstance(frames, int) or frames < 0):
        raise Refusal("bad_value", f"A number of frames is a whole one, not {frames!r}.")
    return frames


class _HostGone(Exception):
    """The host has closed the connection, or has sent something that is not a request."""


class SimulatedEvk4(CameraServer):
    """The simulated camera, for one host at a time; a paced stream arrives at the sensor's own rate.

    ``repeats`` counts the streams of each content; see `SensorStream`.
    """

    def __init__(self, world: World, *, serial: str = "00050423", paced: bool = True) -> None:
        super().__init__("simulated-evk4")
        self.world, self.serial, self.paced = world, serial, paced
        self.repeats: dict[str, int] = {}
        self.time_base = TimeBase()
        self.stream_faults = StreamFaults()
        self._connection: _Connection | None = None

    def close(self) -> None:
        """See `CameraServer.close`."""
        self._closing.set()
        self.unplug()
        super().close()

    def unplug(self) -> None:
        """Break the connection and reset the sensor's clock, as pulling the USB cable does: it powers the camera."""
        connection = self._connection
        if connection is not None:
            connection.hang_up()
            connection.join()
        self.time_base.power_up()

    def report_fault(self, message: str) -> None:
        """Send a fault notification to the connected host; without a host, do nothing."""
        connection = self._connection
        if connection is not None:
            connection.notify(message)

    def _meet(self, link: socket.socket) -> None:
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._connection is not None and not self._connection.ends_within(LEAVING_S):
            with suppress(_HostGone):
                _send(link, b"N", _json({"event": "fault", "message": "Another host holds the camera."}))
            link.close()
            return
        self._connection = _Connection(link, self)
        # Started last: self._connection must be set before the host gets its first answer.
        self._connection.start()


class _Connection:
    """Connection of one host: one thread answers requests, a second one streams between start and stop."""

    def __init__(self, link: socket.socket, camera: SimulatedEvk4) -> None:
        self._socket = link
        self._camera = camera
        self._world = camera.world
        self._send_lock = threading.Lock()
        self._biases = dict(FACTORY)
        self._filters = dict.fromkeys(FILTERS, False)
        self._trigger_in = False
        self._stop = threading.Event()
        self._ended = threading.Event()
        self._streamer: threading.Thread | None = None
        self._preview: SensorStream | None = None
        self._keep_alive = KeepAlive(self._send_computing)
        self._thread = threading.Thread(target=self._serve, name="simulated-evk4-host", daemon=True)

    def start(self) -> None:
        """Start to answer requests."""
        self._keep_alive.start()
        self._thread.start()

    def ends_within(self, seconds: float) -> bool:
        """Whether the host is gone, at the latest after so many seconds."""
        return self._ended.wait(seconds)

    def hang_up(self) -> None:
        """Close the connection from the camera's side."""
        self._stop.set()
        with suppress(OSError):  # the host may already have closed it
            self._socket.shutdown(socket.SHUT_RDWR)

    def join(self) -> None:
        """Wait until the connection has ended."""
        if self._thread.is_alive():
            self._thread.join()

    def notify(self, message: str) -> None:
        """Send a fault notification; ignore a host that is gone."""
        with suppress(_HostGone):
            self._send(b"N", _json({"event": "fault", "message": message}))

    def _send_computing(self) -> None:
        """Tell the host that the camera is still computing."""
        with suppress(_HostGone):
            self._send(b"N", _json({"event": "computing"}))

    # ------------------------------------------------------------- answering

    def _serve(self) -> None:
        """Answer requests until the host closes the connection."""
        try:
            while True:
                request = self._receive()
                with self._keep_alive.computing():
                    answer = self._answer(request)
                self._send(b"A", _json(answer))
        except _HostGone:
            self._stop.set()
        if self._streamer is not None:
            self._streamer.join()
        self._keep_alive.close()
        self._ended.set()  # before the socket closes: the host may connect again as soon as it sees that
        self._socket.close()

    def _receive(self) -> bytes:
        """Return the payload of the next request."""
        kind, length = HEADER.unpack(self._receive_exactly(HEADER.size))
        if kind != b"Q" or length > MAX_REQUEST_BYTES:
            self.notify(f"A frame {kind!r} of {length} bytes is no request.")
            raise _HostGone
        return self._receive_exactly(length)

    def _receive_exactly(self, n: int) -> bytes:
        """Read n bytes from the connection."""
        data = bytearray()
        while len(data) < n:
            try:
                part = self._socket.recv(n - len(data))
            except OSError as error:
                raise _HostGone from error
            if not part:
                raise _HostGone
            data += part
        return bytes(data)

    def _send(self, kind: bytes, payload: bytes) -> None:
        """Send one complete frame."""
        with self._send_lock:
            _send(self._socket, kind, payload)

    def _answer(self, payload: bytes) -> dict[str, Any]:
        """Execute a request and return its answer."""
        number: object = None
        try:
            request = parse_request(payload)
            number = request.get("id")
            name = read_name("command", request.get("cmd"), self._commands())
            return {"id": number, "ok": True, **self._commands()[name](request)}
        except Refusal as refusal:
            return {"id": number, "ok": False, "error": refusal.code, "message": str(refusal)}

    def _commands(self) -> Mapping[str, Callable[[dict[str, Any]], dict[str, Any]]]:
        """Return the handlers of all commands, by name."""
        return {
            "identify": self._identify,
            "get_bias": lambda request: {
                "value": self._biases[read_name("bias", request.get("name"), ALLOWED)]
            },
            "get_biases": lambda _request: {"biases": dict(self._biases)},
            "set_bias": self._set_bias,
            "get_filters": lambda _request: dict(self._filters),
            "set_filter": self._set_filter,
            "get_trigger_in": lambda _request: {"enabled": self._trigger_in},
            "set_trigger_in": self._set_trigger_in,
            "monitor": self._monitor,
            "start": self._start,
            "stop": self._stop_stream,
        }

    def _identify(self, _request: dict[str, Any]) -> dict[str, Any]:
        camera = self._world.truth.camera
        return {
            "maker": "Prophesee",
            "model": "EVK4 (simulated)",
            "sensor": "IMX636",
            "serial": self._camera.serial,
            "firmware": FIRMWARE,
            "width": camera.width,
            "height": camera.height,
            "format": "EVT3",
        }

    def _set_bias(self, request: dict[str, Any]) -> dict[str, Any]:
        name = read_name("bias", request.get("name"), ALLOWED)
        value = request.get("value")
        if isinstance(value, bool) or not isinstance(value, int):
            raise Refusal("bad_value", f"A bias is a whole number, not {value!r}.")
        low, high = ALLOWED[name]
        if not low <= value <= high:
            raise Refusal("out_of_range", f"{name} {value} is outside {low} to {high}.")
        self._refuse_while_streaming()
        self._biases[name] = value
        return {"name": name, "value": value}

    def _set_filter(self, request: dict[str, Any]) -> dict[str, Any]:
        name = read_name("filter", request.get("name"), self._filters)
        enabled = read_enabled(request)
        if enabled and name != "erc":
            raise Refusal("bad_value", f'This camera simulates no filter "{name}".')
        self._refuse_while_streaming()
        self._filters[name] = enabled
        return {"name": name, "enabled": enabled}

    def _set_trigger_in(self, request: dict[str, Any]) -> dict[str, Any]:
        enabled = read_enabled(request)
        self._refuse_while_streaming()
        self._trigger_in = enabled
        return {"enabled": enabled}

    def _monitor(self, _request: dict[str, Any]) -> dict[str, Any]:
        """Return temperature, mean illumination, and the pixel dead time that the biases give."""
        now_s = self._world.now_s()
        light, truth = self._world.light(now_s), self._world.truth_at(now_s)
        settings = PixelSettings.from_biases(self._biases, truth.optics.room)
        driven = light.low + (light.high - light.low) * light.high_share
        mean = settings.ambient + MEAN_COVERAGE * driven * brightness(truth)
        return {
            "temperature_c": self._world.temperature_c(now_s),
            "illumination_lux": round(NOMINAL_LUX * mean, 3),
            "pixel_dead_time_us": round(settings.dead_us, 3),
        }

    # ------------------------------------------------------------- streaming

    def _is_streaming(self) -> bool:
        return self._streamer is not None

    def _refuse_while_streaming(self) -> None:
        if self._is_streaming():
            raise Refusal("streaming", "Settings cannot change while the camera streams.")

    def _start(self, request: dict[str, Any]) -> dict[str, Any]:
        preview = request.get("preview", False)
        if not isinstance(preview, bool):
            raise Refusal("bad_value", f'"preview" is true or false, not {preview!r}.')
        if self._is_streaming():
            raise Refusal("streaming", "The camera streams already.")
        self._stop.clear()
        acting = {**self._filters, "erc": self._filters["erc"] or self._camera.stream_faults.overflows}
        camera = CameraState(dict(self._biases), acting, self._trigger_in)
        self._streamer = threading.Thread(
            target=self._stream, args=(camera, preview), name="simulated-evk4-stream", daemon=True
        )
        self._streamer.start()
        return {}

    def _stop_stream(self, request: dict[str, Any]) -> dict[str, Any]:
        frames = read_frames(request)
        if self._streamer is None:
            raise Refusal("not_streaming", "The camera does not stream.")
        self._stop.set()
        self._streamer.join()
        self._streamer = None
        if frames is not None and not self._camera.time_base.stop(frames):
            raise Refusal("bad_value", f"It has stopped, but not sent {frames} frames.")
        return {}

    def _begun(self, camera: CameraState, *, preview: bool) -> SensorStream:
        """Return a new stream, or the last preview, if it can go on."""
        clock_us = self._camera.time_base.now_us
        if not preview:
            return SensorStream(self._world, camera, self._camera.repeats, clock_us)
        if self._preview is None or not self._preview.go_on(camera, clock_us):
            self._preview = SensorStream(self._world, camera, {}, clock_us, preview=True)
        return self._preview

    def _stream(self, camera: CameraState, preview: bool) -> None:
        """Send frames of EVT3 words until the host stops the stream, each after the sensor has seen it."""
        try:
            with self._keep_alive.computing():
                stream = self._begun(camera, preview=preview)
            self._camera.time_base.start(stream.clock_us)
            while not self._stop.is_set():
                with self._keep_alive.computing():
                    frame = self._camera.stream_faults.apply(stream.next_frame())
                if self._camera.paced and self._stop.wait(max(0.0, stream.covered_s - self._world.now_s())):
                    return
                if frame:
                    self._send(b"D", frame)
                self._camera.time_base.advance(stream.clock_us, sent=bool(frame))
        except SimulatorError as error:
            self.notify(f"The stream broke off: {error}")
        except _HostGone:
            return  # the answering thread sees the same and cleans up


def _send(link: socket.socket, kind: bytes, payload: bytes) -> None:
    """Send one complete frame over a connection."""
    try:
        link.sendall(HEADER.pack(kind, len(payload)) + payload)
    except OSError as error:
        raise _HostGone from error


def _json(content: Mapping[str, Any]) -> bytes:
    """Return an answer or a notification as JSON."""
    return json.dumps(content).encode()
