"""What the maker's camera software writes to standard error, which holds causes that its errors leave out.

The software writes to the file descriptor itself, so Python's ``sys.stderr`` does not see it. What was written appears
on standard error all the same, as soon as the listening ends. No device is touched.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Final

_STDERR: Final = 2
_LISTENING = threading.RLock()
_OLD_FIRMWARE: Final = re.compile(r"serial\s*(\S+)\s*is using an old firmware")
"""OpenEB 5.1.1, ``tz_libusb_board_command.cpp``: written once for each camera in a process, for firmware below 3.8."""

_old: set[str] = set()


@contextmanager
def listening() -> Iterator[list[str]]:
    """Listen to standard error during the block; `cameras_with_old_firmware` then knows what was said.

    Yields: What was said; it is there when the block has ended. If standard error is closed, nothing is
      heard.
    """
    words: list[str] = []
    with _LISTENING, tempfile.TemporaryFile() as heard:
        with suppress(OSError, ValueError, AttributeError):
            sys.stderr.flush()
        try:
            kept = os.dup(_STDERR)
        except OSError:
            yield words
            return
        os.dup2(heard.fileno(), _STDERR)
        try:
            yield words
        finally:
            os.dup2(kept, _STDERR)
            os.close(kept)
            heard.seek(0)
            said = heard.read()
            words.append(said.decode(errors="replace"))
            _old.update(_OLD_FIRMWARE.findall(words[0]))
            with suppress(OSError):
                os.write(_STDERR, said)


def cameras_with_old_firmware() -> frozenset[str]:
    """Return the serial numbers of the cameras that the maker's software refused for their firmware."""
    return frozenset(_old)
