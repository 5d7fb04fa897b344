"""Work in a thread beside the program."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Result = TypeVar("Result")


def in_background(work: Callable[[], Result], name: str, *, left_alone: bool = True) -> Future[Result]:
    """Begin work in a thread of its own; return its future. Work that is ``left_alone`` ends with the program.

    Computing may not be: a program that ends while a thread is in C++ code can be aborted by the system.
    """
    future: Future[Result] = Future()
    threading.Thread(target=settle, args=(future, work), name=name, daemon=left_alone).start()
    return future


def done_at_once(work: Callable[[], Result]) -> Future[Result]:
    """Do work in this thread; return its future, which is done."""
    future: Future[Result] = Future()
    settle(future, work)
    return future


def settle(future: Future[Result], work: Callable[[], Result]) -> None:
    """Do work in this thread; give its result, or its error, to a future."""
    try:
        future.set_result(work())
    except BaseException as error:  # noqa: BLE001 - raised again by who asks the future
        future.set_exception(error)
