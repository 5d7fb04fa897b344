"""Output to terminals and pipes: a plain substitute for what an encoding lacks, or what would steer the terminal."""

from __future__ import annotations

import codecs
import io
import os
import re
import sys
import unicodedata
from typing import Any, TextIO

# Output whose reader has gone (``starbench run ... | head -1``): the work goes on, and what is written is
# dropped.
#
# The exit status then is that of the work. Without this the first line that nobody reads would end the
# program.

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

    def write(self, text: str) -> int:
        """Write text with control characters."""
        write = self._stream.steer if isinstance(self._stream, _PlainText) else self._stream.write
        return write(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)


def protect_output() -> None:
    """Keep standard output and standard error plain, and let them outlive their readers.

    Streams of tests and files are left as they are.
    """
    for name, descriptor in _STANDARD.items():
        stream = getattr(sys, name)
        if isinstance(stream, io.TextIOWrapper) and _is_descriptor(stream, descriptor):
            setattr(sys, name, _reopened(stream, descriptor))


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


_NAME = "starbench-plain"
_PLAIN = {
    "±": "+/-",
    "\N{MINUS SIGN}": "-",
    "≤": "<=",
    "≥": ">=",
    "°": "deg",
    "\N{HORIZONTAL ELLIPSIS}": "...",
}


def replace_unencodable(*streams: TextIO | None) -> None:
    """Make text streams replace characters that their encoding lacks; others are left as they are."""
    codecs.register_error(_NAME, _replaced)
    for stream in streams:
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=_NAME)


_ASCII_CONTROLS = re.compile(r"[\x00-\x08\x0b-\x1f\x7f]")


def printable(text: str) -> str:
    r"""Write characters that would steer a terminal as escape sequences; names of files may hold them.

    >>> print(printable("a\x1b[2Jb"))
    a\x1b[2Jb
    """
    if text.isascii() and not _ASCII_CONTROLS.search(text):  # nearly every text, and the longest ones
        return text
    return "".join(map(_escaped, text))


def _escaped(letter: str) -> str:
    if letter in "\n\t" or unicodedata.category(letter) not in {"Cc", "Cf", "Cs"}:
        return letter
    return (
        letter.encode("ascii", "backslashreplace").decode() if ord(letter) > 0x7F else f"\\x{ord(letter):02x}"
    )


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    missing = error.object[error.start : error.end]
    return "".join(_PLAIN.get(character, "?") for character in missing), error.end


def clock_text(seconds: float) -> str:
    """Return a duration, s, as ``m:ss``, or ``h:mm:ss`` from one hour on; a negative one counts as zero.

    >>> clock_text(75), clock_text(4.2), clock_text(7322)
    ('1:15', '0:04', '2:02:02')
    """
    whole = max(0, round(seconds))
    hours, rest = divmod(whole, 3600)
    minutes, seconds_left = divmod(rest, 60)
    return f"{hours}:{minutes:02d}:{seconds_left:02d}" if hours else f"{minutes}:{seconds_left:02d}"


_TIMES = {1: "once", 2: "twice"}


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural with "s" unless the number is 1.

    >>> counted(1, "recording"), counted(3, "pose"), counted(0, "run")
    ('1 recording', '3 poses', '0 runs')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def times(number: int) -> str:
    """Return how often something was done.

    >>> times(1), times(2), times(5)
    ('once', 'twice', '5 times')
    """
    return _TIMES.get(number, f"{number} times")
