"""Exponential and logarithm in float32, written so that compilers turn loops over them into vector instructions.

For compiled functions only. The relative error of the exponential and the absolute error of the logarithm are below
3e-7.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba import njit
from numba.core.compiler import CompilerBase, DefaultPassBuilder

_SENSOR: Final[dict[str, Any]] = {
    "error_model": "numpy",
    "nogil": True,
    "_nrt": False,
    "no_cfunc_wrapper": True,
    "fastmath": {"nnan", "nsz", "contract"},
}
JIT: Final[dict[str, Any]] = {"cache": True, **_SENSOR}
"""Compiler options of the sensor's loops.

Infinity is kept (a pixel that never requests again). References to arrays are not counted (``_nrt``): the loops neither
create nor return any, and the counting took four times as long as the work itself.
"""
INNER: Final[dict[str, Any]] = {"no_cpython_wrapper": True, **_SENSOR}
"""Compiler options of what only these loops call, as `simulators.compiled.INNER`: never call it from Python."""
_LOG2_E: Final = np.float32(1.0 / math.log(2.0))
_LN_2_HIGH: Final = np.float32(355.0 / 512.0)
"""ln 2 in two parts; the first has so few bits that its multiples are exact (Cody and Waite 1980)."""
_LN_2_LOW: Final = np.float32(math.log(2.0) - 355.0 / 512.0)
_LOWEST: Final = np.float32(-87.0)  # The smallest normal float32 is exp(-87.3)
_SQRT_HALF_BITS: Final = np.int32(np.float32(math.sqrt(0.5)).view(np.int32))
_MANTISSA: Final = np.int32(0x007FFFFF)  # Its 23 bits of a float32


class _NoAlias(CompilerBase):
    """Compiler for functions whose array arguments do not overlap; loops with table look-ups vectorise only then."""

    def define_pipelines(self) -> list[Any]:
        """Return Numba's usual passes, with the arguments marked as not overlapping."""
        self.state.flags.noalias = True
        usual: Any = DefaultPassBuilder.define_nopython_pipeline
        return [usual(self.state)]


INNER_KERNEL: Final[dict[str, Any]] = {**INNER, "pipeline_class": _NoAlias}
"""How the loops over a batch of pixels are compiled; no array argument may overlap another."""


@njit(forceinline=True, **INNER)
def exp32(x: Any) -> Any:
    """Return exp(x) of a float32 x <= 80; below -87 it is exp(-87).

    x = n ln 2 + r with |r| <= ln 2 / 2, ln 2 in two parts (Cody and Waite 1980); Taylor's series of exp(r) to the
    seventh order, times 2^n.
    """
    y = max(np.float32(x), _LOWEST)
    n = np.floor(y * _LOG2_E + np.float32(0.5))
    r = (y - n * _LN_2_HIGH) - n * _LN_2_LOW
    p = np.float32(1.0 / 5040.0) * r + np.float32(1.0 / 720.0)
    p = p * r + np.float32(1.0 / 120.0)
    p = p * r + np.float32(1.0 / 24.0)
    p = p * r + np.float32(1.0 / 6.0)
    p = p * r + np.float32(0.5)
    p = p * r * r + r + np.float32(1.0)
    power = np.int32((np.int32(n) + np.int32(127)) << np.int32(23))
    return p * np.int32(power).view(np.float32)


@njit(forceinline=True, **INNER)
def log32(x: Any) -> Any:
    """Return the logarithm of a positive normal float32: x = 2^n m, ln m = 2 artanh((m - 1) / (m + 1)) by series."""
    bits = np.int32(np.float32(x).view(np.int32) - _SQRT_HALF_BITS)
    n = np.float32(bits >> np.int32(23))
    m = np.int32((bits & _MANTISSA) + _SQRT_HALF_BITS).view(np.float32) - np.float32(1.0)
    s = m / (m + np.float32(2.0))
    z = s * s
    p = np.float32(2.0 / 9.0) * z + np.float32(2.0 / 7.0)
    p = p * z + np.float32(2.0 / 5.0)
    p = p * z + np.float32(2.0 / 3.0)
    # m - s (m - ...) keeps the bits that 2 s alone would lose for x near one
    return (m - s * (m - z * p)) + n * _LN_2_LOW + n * _LN_2_HIGH
