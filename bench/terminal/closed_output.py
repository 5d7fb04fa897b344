"""Output whose reader has gone (``starbench run ... | head -1``): the work goes on, and what is written is dropped.

The exit status then is that of the work. Without this the first line that nobody reads would end the program.
"""

from __future__ import annotations

import io
import os
import sys
from typing import Any

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


def outlive_readers() -> None:
    """Let standard output and standard error outlive their readers. Streams of tests and files are left as they are."""
    for name, descriptor in _STANDARD.items():
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and _is_descriptor(stream, descriptor):
            setattr(sys, name, _reopened(stream, descriptor))


def output_is_lost() -> bool:
    """Return whether the reader of standard output has gone.

    Returns: False as long as nothing was written after it had gone.
    """
    return bool(getattr(getattr(getattr(sys.stdout, "buffer", None), "raw", None), "lost", False))


def _is_descriptor(stream: io.TextIOWrapper, descriptor: int) -> bool:
    try:
        return stream.fileno() == descriptor
    except (OSError, ValueError):  # it is closed, or no file
        return False


def _reopened(stream: io.TextIOWrapper, descriptor: int) -> io.TextIOWrapper:
    stream.flush()
    return io.TextIOWrapper(
        io.BufferedWriter(_Output(descriptor, "wb", closefd=False)),
        encoding=stream.encoding,
        errors=stream.errors,
        line_buffering=stream.line_buffering,
        write_through=stream.write_through,
    )
