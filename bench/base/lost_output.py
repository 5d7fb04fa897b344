"""Output whose reader has gone (``starbench run ... | head -1``): what is written is dropped, the work goes on.

The exit status then is that of the work. Without this the first line that nobody reads would end the program.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any, TextIO, cast

from bench.base.encoding import printable

_STANDARD = {"stdout": 1, "stderr": 2}


class _Output(io.FileIO):
    """Standard output or standard error; once its reader has gone it writes to nowhere."""

    lost = False

    def write(self, data: Any) -> int:
        """Write bytes, or drop them once nobody reads them. Another failure, such as a full disk, is raised once."""
        try:
            return super().write(data)
        except BrokenPipeError:
            self.lost = True
            self._drop_the_rest()
            return memoryview(data).nbytes
        except OSError as error:
            self._drop_the_rest()
            where = "standard output" if self.fileno() == _STANDARD["stdout"] else "standard error"
            raise OSError(error.errno, error.strerror, where) from None

    def _drop_the_rest(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())  # programs that this one starts inherit it
        os.close(nowhere)


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
        io.BufferedWriter(_Output(descriptor, "wb", closefd=False)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
