"""Output whose reader has gone (``starbench run ... | head -1``): what is written is dropped, the work goes on.

The exit status then is that of the work. Without this the first line that nobody reads would end the program. Standard
error, which tells how the work goes on, never fails.
"""

from __future__ import annotations

import io
import os
import select
import stat
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO, cast

from bench.base.encoding import printable

_STANDARD = {"stdout": 1, "stderr": 2}
_PATIENCE_S = 0.2  # A reader that takes nothing for so long has stopped; short beside the grace of a door


class _Output(io.FileIO):
    """Standard output or standard error; once its reader has gone it writes to nowhere."""

    lost = False

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor, "wb", closefd=False)
        self._is_error = descriptor == _STANDARD["stderr"]
        self.nonblocking: int | None = None  # The descriptor to write to in `errors_never_wait`
        self._is_stuck = False

    def write(self, data: Any) -> int:
        """Write bytes, or drop them once nobody reads them. A full disk behind standard output is raised once."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        try:
            while rest:
                rest = rest[self._write_some(rest) :]
        except OSError as error:
            self._drop_the_rest()
            self.lost = self._is_error or isinstance(error, BrokenPipeError)
            if not self.lost:
                raise OSError(error.errno, error.strerror, "standard output") from None
        return size

    def _write_some(self, data: memoryview) -> int:
        """Return how many bytes were written, or dropped because the reader has stopped."""
        if self.nonblocking is None:
            return os.write(self.fileno(), data)
        if not self._is_stuck:
            select.select([], [self.nonblocking], [], _PATIENCE_S)
        try:
            written = os.write(self.nonblocking, data)
        except BlockingIOError:
            self._is_stuck = True
            return len(data)
        self._is_stuck = False
        return written

    def _drop_the_rest(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())  # programs that this one starts inherit it
        if self.nonblocking is not None:
            os.dup2(nowhere, self.nonblocking)
        os.close(nowhere)


@contextmanager
def errors_never_wait() -> Iterator[None]:
    """Drop what nobody reads of standard error (Ctrl-S, a pager, a stalled connection), instead of waiting.

    Work that a signal or an interlock asks to end does not see the request while a write waits.
    """
    raw = getattr(getattr(sys.stderr, "buffer", None), "raw", None)
    if not isinstance(raw, _Output) or (opened := _opened_again(raw.fileno())) is None:
        yield
        return
    before, raw.nonblocking = raw.nonblocking, opened
    try:
        yield
    finally:
        raw.nonblocking = before
        os.close(opened)


def _opened_again(descriptor: int) -> int | None:
    """Return a non-blocking descriptor of the same terminal or pipe; None if the system has none.

    O_NONBLOCK on the first descriptor would hold for all other programs at that terminal, too.
    """
    if hasattr(os, "O_NONBLOCK") and (stat.S_ISFIFO(os.fstat(descriptor).st_mode) or os.isatty(descriptor)):
        with suppress(OSError):  # another user's terminal, as under `su`, or a system without such files
            return os.open(f"/proc/self/fd/{descriptor}", os.O_WRONLY | os.O_NONBLOCK | os.O_NOCTTY)
    return None


class _PlainText(io.TextIOWrapper):
    """A stream of plain text: names of folders, people and devices stand in what is printed, and may be hostile."""

    def write(self, text: str) -> int:
        """Write text; characters that would steer a terminal become escape sequences."""
        super().write(printable(text))
        return len(text)

    def steer(self, text: str) -> int:
        """Write text that steers the terminal; every part that comes from elsewhere is `printable` already."""
        return super().write(text)


class Steering:
    """A stream through which a display may move the cursor; all other text to this stream stays plain."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    @classmethod
    def of(cls, stream: TextIO) -> TextIO:
        """Return the stream for a display: all that is not written here is the stream's own."""
        return cast("TextIO", cls(stream))

    def write(self, text: str) -> int:
        """Write text with control characters."""
        write = self._stream.steer if isinstance(self._stream, _PlainText) else self._stream.write
        return write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def protect_output() -> None:
    """Keep standard output and standard error plain, and let them outlive their readers.

    Streams of tests and files are left as they are. What a service or ``2>&-`` has closed goes to nowhere; else the
    first line would end the work, and a file of the run would take the place of standard error.
    """
    _replace_closed()
    for name, descriptor in _STANDARD.items():
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and _is_descriptor(stream, descriptor):
            setattr(sys, name, _reopened(stream, descriptor))


def _replace_closed() -> None:
    for descriptor, (name, mode) in enumerate([("stdin", "r"), ("stdout", "w"), ("stderr", "w")]):
        try:
            os.fstat(descriptor)
        except OSError:
            nowhere = os.open(os.devnull, os.O_RDWR)  # takes the lowest place that is free: this one
            os.set_inheritable(nowhere, True)  # else a file of a child process would take it
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(descriptor, mode, encoding="utf-8", closefd=False))


def output_is_lost() -> bool:
    """Return whether the reader of standard output has gone, by the last write."""
    return bool(getattr(getattr(getattr(sys.stdout, "buffer", None), "raw", None), "lost", False))


def _is_descriptor(stream: io.TextIOWrapper, descriptor: int) -> bool:
    try:
        return stream.fileno() == descriptor
    except (OSError, ValueError):  # it is closed, or no file
        return False


def _reopened(stream: io.TextIOWrapper, descriptor: int) -> _PlainText:
    stream.flush()
    return _PlainText(
        io.BufferedWriter(_Output(descriptor)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
