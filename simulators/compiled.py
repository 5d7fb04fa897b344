"""How the simulators' loops are compiled by numba."""

from __future__ import annotations

from typing import Any, Final

LOOP: Final[dict[str, Any]] = {"cache": True, "nogil": True, "no_cfunc_wrapper": True}
"""Compiler options of a loop that Python calls. Nothing but Python and other loops calls it: no entry for C."""

INNER: Final[dict[str, Any]] = {"nogil": True, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
"""Compiler options of a function that only loops call: a call from Python would crash the process.

An entry for Python, which takes every argument apart, costs a quarter of the time of compiling; its file would never be
read.
"""
