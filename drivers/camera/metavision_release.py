"""Let go of the objects of the Metavision HAL when a call fails, and do not take its calls for a busy computer.

The HAL gives a camera back when the last of its objects goes, and has no call for it. An error that is kept, as the
cause of a hold, keeps the variables of all functions that it passed, and with them such objects. The same program
could then not open the camera again. No device is touched here.

Opening takes 2.6 s or more, and a command that the camera does not answer 10 s. No other thread of Python runs then.
"""

from __future__ import annotations

import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from drivers.lateness import own_lateness


@contextmanager
def lets_go(*, holds: bool = False) -> Iterator[None]:
    """Empty the variables of the functions that an error has passed on its way out of the block.

    holds: Whether the block may keep other threads from running, so that their delay does not count.
    Yields: During the block.
    """
    outside = sys.exception()
    try:
        with own_lateness().interpreter_held() if holds else nullcontext():
            yield
    except BaseException as error:
        _clear(error, outside)
        raise


def _clear(error: BaseException | None, outside: BaseException | None) -> None:
    """Empty the variables behind an error and its causes, up to the error that the caller was handling already."""
    cleared: set[int] = set()
    waiting = [error]
    while waiting:
        one = waiting.pop()
        if one is None or one is outside or id(one) in cleared:
            continue
        cleared.add(id(one))
        traceback.clear_frames(one.__traceback__)
        waiting += [one.__cause__, one.__context__]
