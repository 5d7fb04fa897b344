"""Asks the panel's helper process (`bench.panel.helper_process`); starts it when it is needed first."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from typing import Any

Json = dict[str, Any]
Answer = tuple[Json, bytes]

_MODULE = "bench.panel.helper_process"
_MOST_PICTURES = 60
_END_S = 2.0


class Helper:
    """The helper process, for all pages together. For any thread; one request at a time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._kept: OrderedDict[tuple[Any, ...], Answer] = OrderedDict()
        self._closed = False

    def ask(self, operation: str, **arguments: Any) -> Answer:
        """Ask for something, and wait for it.

        operation: Key of `bench.panel.helper_process.OPERATIONS`.
        Returns: The answer, with ``fault`` if it failed; and its bytes.
        """
        with self._lock:
            if self._closed:
                return {"fault": "The panel is ending."}, b""
            try:
                return self._exchange({"operation": operation, **arguments})
            except (OSError, ValueError):
                self._end()
                return {
                    "fault": "The helper process of the panel has ended; it is started again with the next request."
                }, b""

    def picture(self, key: tuple[Any, ...], ask: Callable[[], Json]) -> Answer:
        """Return a picture; one that was made before is not made again.

        ask: Returns the arguments of the operation ``picture``.
        Returns: As `ask`.
        """
        if key in self._kept:
            return self._kept[key]
        answer = self.ask("picture", **ask())
        if answer[1]:
            self._kept[key] = answer
            while len(self._kept) > _MOST_PICTURES:
                with suppress(KeyError):
                    self._kept.popitem(last=False)
        return answer

    def close(self) -> None:
        """End the process."""
        self._closed = True
        process = self._process
        if process is not None:
            process.kill()
        with self._lock:
            self._end()

    def _exchange(self, request: Json) -> Answer:
        process = self._process
        if process is None or process.poll() is not None:
            self._end()
            process = self._process = _start()
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(request).encode() + b"\n")
        process.stdin.flush()
        line = process.stdout.readline()
        if not line:
            raise OSError("no answer")
        answer = json.loads(line)
        data = process.stdout.read(answer.pop("bytes"))
        return answer, data

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        process.kill()
        with suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()


def _start() -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [sys.executable, "-m", _MODULE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=dict(os.environ),
    )
