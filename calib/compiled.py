"""How the engine's loops are compiled by numba, and its linear algebra done: on one thread, as matrices are small."""

from __future__ import annotations

from typing import Any, Final

KERNEL: Final[dict[str, Any]] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
}
"""Compiler options. A run goes on beside these loops (``nogil``). Only Python and other loops call them: an entry for C
costs 4 % of the time of compiling."""

INNER: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "no_cfunc_wrapper": True,
    "no_cpython_wrapper": True,
    "_nrt": False,
}
"""Compiler options of a function that only loops call, and that makes no arrays: references to its arguments are not
counted. Without an entry for Python, less is compiled; a call from Python would crash the process. A loop whose sums
may be reordered is always inlined. Else the process that compiles it gets other last bits than all later processes."""
