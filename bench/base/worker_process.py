"""A process of this program's own that answers questions one after the other, so that its caller's threads do not wait.

Questions and answers are pickled on its standard input and output; both ends are this program.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

_DIES_S = 0.5  # A process that has closed its line is gone by then


class WorkerProcess:
    """The process of a module that calls `answer_questions`. For any thread; one question at a time."""

    def __init__(self, module: str, environment: Mapping[str, str] | None = None) -> None:
        self._module = module
        self._environment = {**os.environ, **(environment or {})}
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self.closed = False
        self.exit_code: int | None = None
        """Status with which the process ended last; None while none has."""

    def start(self) -> subprocess.Popen[bytes]:
        """Start the process, which `ask` does too where there is none."""
        # A session of its own: Ctrl-C at the terminal is for the caller's process alone.
        self._process = subprocess.Popen(
            [sys.executable, "-m", self._module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
            env=self._environment,
        )
        return self._process

    def ask(self, question: Any) -> Any:
        """Return the answer. Raises EOFError if the process has ended, or is closed; the next question starts it."""
        with self._lock:
            if self.closed:
                raise EOFError
            asked = pickle.dumps(question, pickle.HIGHEST_PROTOCOL)
            process = self._process or self.start()
            if self.closed:  # while the process was started, which `close` did not see
                process.kill()
            assert process.stdin is not None
            assert process.stdout is not None
            try:
                process.stdin.write(asked)
                process.stdin.flush()
                return pickle.load(process.stdout)  # noqa: S301 - both ends are this program
            except (OSError, EOFError, ValueError, pickle.UnpicklingError) as error:
                self._end()
                raise EOFError from error

    def close(self) -> None:
        """End the process, also while another thread waits for its answer."""
        self.closed = True
        if self._process is not None:
            self._process.kill()
        with self._lock:
            self._end()

    def _end(self) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(subprocess.TimeoutExpired):
            process.wait(_DIES_S)  # else the status would be that of the kill
        process.kill()
        self.exit_code = process.wait()
        for pipe in (process.stdin, process.stdout):
            if pipe is not None:
                with suppress(OSError):  # what was not sent yet is lost with the process
                    pipe.close()


def answer_questions(answer: Callable[[Any], Any]) -> None:
    """Answer the questions of the process that started this one, until it closes the line."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints must not come between the answers
    with suppress(EOFError, OSError):
        while True:
            question = pickle.load(sys.stdin.buffer)  # noqa: S301 - both ends are this program
            pickle.dump(answer(question), answers, pickle.HIGHEST_PROTOCOL)
            answers.flush()
