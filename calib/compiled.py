"""How the engine's loops are compiled by numba, and its linear algebra done: on one thread, as matrices are small."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, Final, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

KERNEL: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Compiler options. Only Python and other loops call these loops: an entry for C costs 4 % of the time of compiling."""

INNER: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
    "_nrt": False,
}
"""Compiler options of a function that only loops call, and that makes no arrays: references to its arguments are not
counted. Without an entry for Python, less is compiled; a call from Python would crash the process. A loop whose sums
may be reordered is always inlined. Else the process that compiles it gets other last bits than all later processes."""


# Linear algebra on one thread: the engine's matrices are small, and a second thread waits longer than it works.

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function's linear algebra use one thread: a calibration then takes 1 s, not 16, on two busy processors."""

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
