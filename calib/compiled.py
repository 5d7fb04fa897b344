"""How the engine's loops are compiled by numba."""

from __future__ import annotations

from typing import Any, Final

KERNEL: Final[dict[str, Any]] = {"cache": True, "error_model": "numpy", "no_cfunc_wrapper": True}
"""Compiler options. Only Python and other loops call these loops: an entry for C costs 4 % of the time of compiling."""
