"""Measures slices in a process of its own, so that a stop and the page never wait for a measurement.

The engine's compiled loops hold Python's global lock for tens of milliseconds. The process ends when its input closes.
"""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
import sys
import threading
from contextlib import suppress
from typing import IO, Any, Final, NamedTuple, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from bench.align.live_figures import LiveFigures, LiveMeter, LiveSetting, LiveSlice
from bench.base.errors import BenchError

JPEG_QUALITY: Final = 82
_LENGTH: Final = struct.Struct("<Q")
_FORGET: Final = "forget"
_END_S: Final = 3.0
_ONE_THREAD: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Small matrices gain nothing from more threads, and these take the cores from camera and page."""


class Measured(NamedTuple):
    """What a slice showed."""

    image: NDArray[np.uint8]  # (H, W) uint8
    jpeg: bytes
    figures: LiveFigures


class Meter(Protocol):
    """Measures one slice after the other."""

    def measure(self, part: LiveSlice, setting: LiveSetting) -> Measured:
        """Measure a slice. Raises BenchError if it could not be measured; the next one may be."""
        ...

    def forget(self) -> None:
        """Forget the course of the focus."""
        ...

    def close(self) -> None:
        """End the measuring."""
        ...


class MeterHere:
    """Measures in this process, for tests and programs without a page. See `Meter`."""

    def __init__(self) -> None:
        self._meter = LiveMeter()

    def measure(self, part: LiveSlice, setting: LiveSetting) -> Measured:
        """See `Meter.measure`."""
        image, figures = self._meter.measure(part, setting)
        coded, jpeg = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        return Measured(image, jpeg.tobytes() if coded else b"", figures)

    def forget(self) -> None:
        """See `Meter.forget`."""
        self._meter.forget()

    def close(self) -> None:
        """See `Meter.close`."""


class MeterProcess:
    """Measures in a process of its own. See `Meter`."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._closed = False
        self._process = self._started()

    def measure(self, part: LiveSlice, setting: LiveSetting) -> Measured:
        """See `Meter.measure`. A process that has ended is started again."""
        with self._lock:
            answer = self._ask((part, setting))
        if isinstance(answer, str):
            raise BenchError(
                f"The slice could not be measured: {answer}",
                remedy="The next one is tried. Report it if it stays.",
            )
        return Measured(*answer)

    def forget(self) -> None:
        """See `Meter.forget`. A process that has just ended has forgotten already."""
        with self._lock, suppress(BenchError):
            self._ask(_FORGET)

    def close(self) -> None:
        """See `Meter.close`."""
        self._closed = True
        _end(self._process)
        with self._lock:  # a thread that waits for an answer has been woken by the end of the process
            _close_pipes(self._process)

    def _ask(self, message: Any) -> Any:
        stdin, stdout = self._process.stdin, self._process.stdout
        assert stdin is not None
        assert stdout is not None
        try:
            _send(stdin, message)
            return _receive(stdout)
        except (OSError, EOFError, ValueError) as error:
            if not self._closed:
                _end(self._process)
                _close_pipes(self._process)
                self._process = self._started()
            raise BenchError(
                "The process that measures has ended by itself.",
                remedy="It is started again; wait some seconds.",
            ) from error

    @staticmethod
    def _started() -> subprocess.Popen[bytes]:
        # A session of its own: Ctrl-C at the terminal is for the page's process alone.
        return subprocess.Popen(
            [sys.executable, "-m", "bench.align.meter"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env={**os.environ, **_ONE_THREAD},
        )


def serve_measurements(requests: IO[bytes], answers: IO[bytes]) -> None:
    """Measure what is asked for until the requests end."""
    meter = MeterHere()
    while True:
        try:
            message = _receive(requests)
        except (EOFError, OSError):
            return
        answer: Any
        try:
            answer = None if message == _FORGET else tuple(meter.measure(*message))
            if message == _FORGET:
                meter.forget()
        except Exception as error:  # noqa: BLE001 - one bad slice must not end the measuring
            answer = f"{type(error).__name__}: {error}"
        try:
            _send(answers, answer)
        except OSError:
            return


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(timeout=_END_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _close_pipes(process: subprocess.Popen[bytes]) -> None:
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with suppress(OSError):  # what was not sent yet is lost with the process
                stream.close()


def _send(stream: IO[bytes], message: Any) -> None:
    data = pickle.dumps(message, pickle.HIGHEST_PROTOCOL)
    stream.write(_LENGTH.pack(len(data)) + data)
    stream.flush()


def _receive(stream: IO[bytes]) -> Any:
    """Read one message of our own process. Raises EOFError at its end."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        raise EOFError
    (length,) = _LENGTH.unpack(head)
    data = stream.read(length)
    if len(data) < length:
        raise EOFError
    return pickle.loads(data)  # noqa: S301 - both ends are this program


def main() -> None:
    """Measure for the process that has started this one."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not come between the answers
    serve_measurements(sys.stdin.buffer, answers)


if __name__ == "__main__":
    main()
