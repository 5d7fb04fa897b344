"""Vector instructions and bit counts for the sensor's loops, stated in LLVM's language.

Numba compiles a loop over a row of pixels to vector instructions only in simple cases, and counts bits in software.
These functions are for compiled code only; they read and write where they are told.

References
----------
LLVM Project, "LLVM Language Reference Manual", https://llvm.org/docs/LangRef.html.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils as untyped_cgutils
from numba.extending import intrinsic as untyped_intrinsic

from simulators.pixels.fast_math import JIT

intrinsic: Any = untyped_intrinsic
cgutils: Any = untyped_cgutils

BLOCK: Final = 32
"""Pixels of a block: one vector triple of the EVT3 format."""

FEWEST_BITS: Final = 8
MOST_BITS: Final = 64
"""Fewest and most numbers that are compared at once."""

_BIT: Final = ir.IntType(1)
_INT: Final = ir.IntType(32)
_FLOAT: Final = ir.FloatType()
_LANES: Final = 8

_PLACES: Final = np.array(
    [([k for k in range(8) if byte >> k & 1] + [0] * 8)[:8] for byte in range(256)], np.uint8
).ravel()
"""The places of the bits that are set in each byte, lowest first."""


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any, what: Any) -> Any:
    """Return a pointer to an element of an array with one axis, as a pointer to ``what``."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(what))


def _splat(builder: Any, value: Any, n: int) -> Any:
    """Return a vector of n equal numbers."""
    vector = ir.Constant(ir.VectorType(value.type, n), ir.Undefined)
    places = ir.Constant(ir.VectorType(_INT, n), [0] * n)
    return builder.shuffle_vector(builder.insert_element(vector, value, ir.Constant(_INT, 0)), vector, places)


def _smaller(builder: Any, a: Any, b: Any) -> Any:
    """Return the smaller of two numbers, or of each pair in two vectors."""
    return builder.select(builder.fcmp_ordered("<", b, a), b, a)


@intrinsic
def count_bits(_typing: Any, bits: Any) -> Any:
    """Return the number of bits set in an unsigned integer, in the same type."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return bits(bits), generate


@intrinsic
def _smallest_of_many(_typing: Any, values: Any) -> Any:
    """Return the smallest of at least eight float32: eight at a time, and the last eight once more."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, args[0])
        size = builder.extract_value(array.shape, 0)
        vector = ir.VectorType(_FLOAT, _LANES)
        lanes = ir.Constant(size.type, _LANES)

        def load(index: Any) -> Any:
            place = builder.bitcast(builder.gep(array.data, [index]), ir.PointerType(vector))
            return builder.load(place, align=4)

        found = cgutils.alloca_once_value(builder, load(builder.sub(size, lanes)))
        with cgutils.for_range(builder, builder.udiv(size, lanes)) as loop:
            builder.store(_smaller(builder, builder.load(found), load(builder.mul(loop.index, lanes))), found)
        rest = builder.load(found)
        for step in (4, 2, 1):
            places = ir.Constant(ir.VectorType(_INT, _LANES), [(k + step) % _LANES for k in range(_LANES)])
            rest = _smaller(builder, rest, builder.shuffle_vector(rest, rest, places))
        return builder.extract_element(rest, ir.Constant(_INT, 0))

    return types.float32(values), generate


@njit(forceinline=True, **JIT)
def smallest(values: Any) -> Any:
    """Return the smallest of some numbers.

    values: (N,) float32, at least one number; none is NaN.
    """
    if values.size >= _LANES:
        return _smallest_of_many(values)
    found = values[0]
    for k in range(1, values.size):
        found = min(found, values[k])
    return found


def _comparison(operator: str) -> Any:
    """Return a function that compares eight float32 from an index on with a number, a bit each."""

    @intrinsic
    def compare(_typing: Any, values: Any, _i: Any, _wanted: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            vector = ir.VectorType(_FLOAT, _LANES)
            place = _address(context, builder, signature.args[0], args[0], args[1], vector)
            found = builder.fcmp_ordered(
                operator, builder.load(place, align=4), _splat(builder, args[2], _LANES)
            )
            return builder.zext(builder.bitcast(found, ir.IntType(8)), ir.IntType(64))

        return types.uint64(values, types.int64, types.float32), generate

    return compare


_equal = _comparison("==")
_at_most = _comparison("<=")


@njit(forceinline=True, **JIT)
def bits_at_most(values: Any, limit: Any) -> Any:
    """Return which of some numbers are at most as large as a limit, a bit each.

    values: (N,) float32; N from 8 to 64.
    limit: Limit, float32.
    Returns: The lowest bit is that of the first number.
    """
    last = values.size - _LANES
    bits = _at_most(values, last, limit) << np.uint64(last)
    for k in range(0, last, _LANES):
        bits |= _at_most(values, k, limit) << np.uint64(k)
    return bits


@njit(forceinline=True, **JIT)
def first_equal(values: Any, wanted: Any) -> Any:
    """Return the index of the first number that equals the wanted one; 0 if none does.

    values: (N,) float32.
    wanted: Number, float32.
    """
    if FEWEST_BITS <= values.size <= MOST_BITS:
        last = values.size - _LANES
        bits = _equal(values, last, wanted) << np.uint64(last)
        for k in range(0, last, _LANES):
            bits |= _equal(values, k, wanted) << np.uint64(k)
        return lowest_bit(bits) if bits else np.int64(0)
    for i in range(values.size):
        if values[i] == wanted:
            return np.int64(i)
    return np.int64(0)


@njit(forceinline=True, **JIT)
def lowest_bit(bits: Any) -> Any:
    """Return the place of the lowest bit that is set.

    bits: Unsigned integer, not 0.
    """
    wide = np.uint64(bits)
    return np.int64(count_bits(~wide & (wide - np.uint64(1))))


@intrinsic
def waiting(_typing: Any, t_next: Any, is_on: Any, _t: Any) -> Any:
    """Return which pixels of a block wait, a bit each, and which of these have an ON event.

    t_next: (BLOCK,) float32, next requests, us after the epoch.
    is_on: (BLOCK,) uint8, their polarities in bit 0.
    _t: Present time, float32.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        zero = ir.Constant(ir.IntType(64), 0)
        times, bytes_ = ir.VectorType(_FLOAT, BLOCK), ir.VectorType(ir.IntType(8), BLOCK)
        t = builder.load(_address(context, builder, signature.args[0], args[0], zero, times), align=4)
        on = builder.load(_address(context, builder, signature.args[1], args[1], zero, bytes_), align=1)
        asking = builder.fcmp_ordered("<=", t, _splat(builder, args[2], BLOCK))
        on = builder.trunc(on, ir.VectorType(_BIT, BLOCK))
        masks = [builder.bitcast(found, _INT) for found in (asking, builder.and_(asking, on))]
        return context.make_tuple(builder, signature.return_type, masks)

    masks: Any = types.UniTuple
    return masks(types.uint32, 2)(t_next, is_on, types.float32), generate


@intrinsic
def _write_places(_typing: Any, table: Any, _byte: Any, _first: Any, out: Any, _n: Any) -> Any:
    """Write the eight places that the table has for a byte, counted from ``first``, from index n on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        element = context.get_data_type(kinds[3].dtype)
        wide, narrow = ir.VectorType(element, _LANES), ir.VectorType(ir.IntType(8), _LANES)
        row = builder.mul(args[1], ir.Constant(args[1].type, _LANES))
        places = builder.load(_address(context, builder, kinds[0], args[0], row, narrow), align=1)
        first = builder.trunc(args[2], element) if element.width < 64 else args[2]
        columns = builder.add(builder.zext(places, wide), _splat(builder, first, _LANES))
        builder.store(columns, _address(context, builder, kinds[3], args[3], args[4], wide), align=1)
        return context.get_dummy_value()

    return types.none(table, types.uint64, types.uint64, out, types.uint64), generate


@njit(forceinline=True, **JIT)
def list_bits(bits: Any, first: Any, out: Any, n: Any) -> None:
    """Write the place of each bit that is set, lowest first; BLOCK places are touched.

    bits: One bit a place, uint32.
    first: Place of the lowest bit, uint64.
    out: (N,) unsigned integers, filled in from n on.
    n: Index of the first place to write, uint64.
    """
    for k in range(4):
        byte = np.uint64(bits >> np.uint32(8 * k)) & np.uint64(0xFF)
        _write_places(_PLACES, byte, first + np.uint64(8 * k), out, n)
        n += count_bits(byte)


@intrinsic
def prefetch(_typing: Any, array: Any, _i: Any) -> Any:
    """Ask for the cache line of element i of an array with one axis, without waiting for it.

    array: (N,) array.
    _i: Index, int64.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        place = builder.bitcast(builder.gep(data, [args[1]]), ir.PointerType(ir.IntType(8)))
        kind = ir.FunctionType(ir.VoidType(), [ir.PointerType(ir.IntType(8)), _INT, _INT, _INT])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [place, *(ir.Constant(_INT, number) for number in (0, 3, 1))])
        return context.get_dummy_value()

    return types.none(array, types.int64), generate
