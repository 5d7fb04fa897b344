"""How the engine's loops are compiled by numba."""

from __future__ import annotations

from typing import Any, Final

KERNEL: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Compiler options. Only Python and other loops call these loops: an entry for C costs 4 % of the time of compiling."""

INNER_WITH_ARRAYS: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
}
"""Compiler options of a function that only loops call, and that makes arrays. Without an entry for Python, less is
compiled; a call from Python would crash the process."""

INNER: Final[dict[str, Any]] = {**INNER_WITH_ARRAYS, "_nrt": False}
"""The same of one that makes no arrays: references to its arguments need not be counted."""
