"""Work in a thread that may be left alone."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

Result = TypeVar("Result")


def in_background(work: Callable[[], Result], name: str) -> Future[Result]:
    """Begin work in a thread of its own, which does not keep the program from ending; return its future."""
    future: Future[Result] = Future()

    def do() -> None:
        try:
            future.set_result(work())
        except BaseException as error:  # noqa: BLE001 - raised again by who asks the future
            future.set_exception(error)

    threading.Thread(target=do, name=name, daemon=True).start()
    return future
