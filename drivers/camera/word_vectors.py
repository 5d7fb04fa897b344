"""Vector instructions on EVT3 words and event columns, for compiled functions only.

Numba compiles a loop over 32 words to vector instructions only in simple cases. These functions state the vectors
themselves, in LLVM's language, which is translated for every processor. They read and write where they are told:
the caller makes sure that there are 32 words to read and as many places to write.

References
----------
LLVM Project, "LLVM Language Reference Manual", https://llvm.org/docs/LangRef.html.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from llvmlite import binding, ir  # type: ignore[import-untyped]
from numba import njit, types
from numba.core import cgutils as untyped_cgutils
from numba.extending import intrinsic as untyped_intrinsic

intrinsic: Any = untyped_intrinsic
cgutils: Any = untyped_cgutils

JIT: Final[dict[str, Any]] = {"cache": True, "nogil": True, "_nrt": False}
"""How the decoder's loops are compiled: without reference counts of arrays (``_nrt``). The loops allocate no arrays,
and counting references took most of the time of the rarer words.
"""
BLOCK_WORDS: Final = 32
"""Number of words that are looked at together."""

COMPRESSES: Final = bool(binding.get_host_cpu_features().get("avx512vbmi2"))
"""Whether the processor can move chosen words of a vector together in one instruction."""

_STEPS: Final = (1, 2, 4, 8, 16)
"""Distances between the words that are compared, in the steps of a prefix maximum."""

_BIT: Final = ir.IntType(1)
_BYTE: Final = ir.IntType(8)
_WORD: Final = ir.IntType(16)
_LONG: Final = ir.IntType(64)

_COLUMNS: Final = np.array(
    [([k for k in range(8) if byte >> k & 1] + [0] * 8)[:8] for byte in range(256)], np.uint8
).ravel()
"""The places of the bits that are set in each byte, lowest first."""


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any, what: Any) -> Any:
    """Return a pointer to an element of an array, as a pointer to ``what``."""
    data = context.make_array(kind)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [index]), ir.PointerType(what))


def _splat(builder: Any, value: Any, n: int) -> Any:
    """Return a vector of n equal numbers."""
    vector = ir.VectorType(value.type, n)
    zero = ir.Constant(ir.IntType(32), 0)
    first = builder.insert_element(ir.Constant(vector, ir.Undefined), value, zero)
    places = ir.Constant(ir.VectorType(ir.IntType(32), n), [0] * n)
    return builder.shuffle_vector(first, ir.Constant(vector, ir.Undefined), places)


def _many(value: int, n: int = BLOCK_WORDS) -> Any:
    """Return a constant vector of n equal words."""
    return ir.Constant(ir.VectorType(_WORD, n), [value] * n)


@intrinsic
def count_ones(_typing: Any, bits: Any) -> Any:
    """Return the number of bits set in an unsigned integer, in the same type."""

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.ctpop(args[0])

    return bits(bits), generate


@intrinsic
def lowest_place(_typing: Any, _bits: Any) -> Any:
    """Return the place of the lowest bit set in a uint64; 64 if none is.

    _bits: Bits, uint64.
    Returns: Place, 0 for the lowest bit.
    """

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.cttz(args[0], ir.Constant(_BIT, 0))

    return types.uint64(types.uint64), generate


@intrinsic
def highest_place(_typing: Any, _bits: Any) -> Any:
    """Return the place of the highest bit set in a uint64, which is not 0.

    _bits: Bits, uint64.
    Returns: Place, 0 for the lowest bit.
    """

    def generate(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
        return builder.xor(builder.ctlz(args[0], ir.Constant(_BIT, 1)), ir.Constant(_LONG, 63))

    return types.uint64(types.uint64), generate


def _greatest_before(builder: Any, lows: Any, now: Any) -> Any:
    """Return for each word the greatest of ``now`` and the numbers before it: a prefix maximum, by doubling steps."""
    zeros = _many(0)
    places = ir.VectorType(ir.IntType(32), BLOCK_WORDS)
    shift = ir.Constant(places, [BLOCK_WORDS, *range(BLOCK_WORDS - 1)])
    found = builder.shuffle_vector(lows, _splat(builder, now, BLOCK_WORDS), shift)
    for step in _STEPS:
        shift = ir.Constant(places, [*[BLOCK_WORDS] * step, *range(BLOCK_WORDS - step)])
        moved = builder.shuffle_vector(found, zeros, shift)
        found = builder.select(builder.icmp_unsigned(">", found, moved), found, moved)
    return found


@intrinsic
def word_masks(_typing: Any, words: Any, _i: Any, _width: Any, _height: Any, _high: Any, _low: Any) -> Any:
    """Sort BLOCK_WORDS words by their type: one bit a word, from the lowest on.

    The bits are set for single events within ``width``; for rows within ``height``; for TIME_LOW; for ON events; and
    for plain words. These are single events, rows and TIME_LOW words that do not step back, neither among themselves
    nor behind ``low``, the TIME_LOW in force, and the word ``high``, the TIME_HIGH in force.

    words: (N,) uint16, EVT3 words.
    _i: Index of the first word, uint64.
    _width, _height: Size of the sensor, px, int64.
    _high: The TIME_HIGH in force as a word, int64.
    _low: The TIME_LOW in force, us, int64.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = ir.VectorType(_WORD, BLOCK_WORDS)
        words = builder.load(_address(context, builder, signature.args[0], args[0], args[1], vector), align=1)
        width, height, high = (
            _splat(builder, builder.trunc(number, _WORD), BLOCK_WORDS) for number in args[2:5]
        )
        address = builder.and_(words, _many(0xF7FF))
        events = builder.icmp_unsigned("<", builder.sub(address, _many(0x2000)), width)
        rows = builder.icmp_unsigned("<", address, height)
        lows = builder.icmp_unsigned("==", builder.and_(words, _many(0xF000)), _many(0x6000))
        on = builder.icmp_unsigned("==", builder.and_(words, _many(0xF800)), _many(0x2800))
        low = builder.select(lows, builder.and_(words, _many(0xFFF)), _many(0))
        now = _splat(builder, builder.trunc(args[5], _WORD), BLOCK_WORDS)
        before = _greatest_before(builder, low, ir.Constant(_WORD, 0))
        onward = builder.and_(builder.icmp_unsigned(">=", low, now), builder.icmp_unsigned(">=", low, before))
        onward = builder.and_(lows, onward)
        plain = builder.or_(builder.or_(events, rows), onward)
        plain = builder.or_(plain, builder.icmp_unsigned("==", words, high))
        masks = [
            builder.zext(builder.bitcast(found, ir.IntType(BLOCK_WORDS)), _LONG)
            for found in (events, rows, lows, on, plain)
        ]
        return context.make_tuple(builder, signature.return_type, masks)

    number = types.int64
    masks: Any = types.UniTuple
    return masks(types.uint64, 5)(words, types.uint64, *[number] * 4), generate


def _in_force(builder: Any, words: Any, row_now: Any, low_now: Any) -> tuple[Any, Any]:
    """Return row and TIME_LOW in force before each of the words; see `write_in_force`."""
    kind = builder.and_(words, _many(0xF000))
    low = builder.select(
        builder.icmp_unsigned("==", kind, _many(0x6000)), builder.and_(words, _many(0xFFF)), _many(0)
    )
    after = ir.Constant(words.type, [(k + 1) % BLOCK_WORDS << 11 for k in range(BLOCK_WORDS)])
    placed = builder.or_(builder.and_(words, _many(0x7FF)), after)
    row = builder.select(builder.icmp_unsigned("==", kind, _many(0)), placed, _many(0))
    rows = builder.and_(_greatest_before(builder, row, builder.trunc(row_now, _WORD)), _many(0x7FF))
    return rows, _greatest_before(builder, low, builder.trunc(low_now, _WORD))


@intrinsic
def write_in_force(
    _typing: Any, words: Any, _i: Any, _row: Any, _low: Any, rows_out: Any, lows_out: Any
) -> Any:
    """Write row and TIME_LOW in force before each of BLOCK_WORDS words, the first of which follows ``row`` and ``low``.

    TIME_LOW must not step back. A row is found as the greatest number before a word, with its place in the upper bits.

    words: (N,) uint16, EVT3 words.
    _i: Index of the first word, uint64.
    _row: Row in force, px, int64.
    _low: TIME_LOW in force, us, int64.
    rows_out, lows_out: (BLOCK_WORDS,) uint16, filled in: row (px) and TIME_LOW (us) for each word.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector, kinds = ir.VectorType(_WORD, BLOCK_WORDS), signature.args
        words = builder.load(_address(context, builder, kinds[0], args[0], args[1], vector), align=1)
        rows, lows = _in_force(builder, words, args[2], args[3])
        zero = ir.Constant(_LONG, 0)
        builder.store(rows, _address(context, builder, kinds[4], args[4], zero, vector), align=1)
        builder.store(lows, _address(context, builder, kinds[5], args[5], zero, vector), align=1)
        return context.get_dummy_value()

    number = types.int64
    return types.none(words, types.uint64, number, number, rows_out, lows_out), generate


def _moved_together(builder: Any, words: Any, chosen: Any) -> Any:
    """Return the chosen words of a vector, one beside the other; only for processors that have `COMPRESSES`."""
    kind = ir.FunctionType(words.type, [words.type, words.type, chosen.type])
    name = "llvm.x86.avx512.mask.compress.v32i16"
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), [words, _many(0), chosen])


@intrinsic
def write_singles(
    _typing: Any, words: Any, _i: Any, _found: Any, _t: Any, _row: Any, t_out: Any, x_out: Any, y_out: Any,
    p_out: Any, _n: Any
) -> Any:  # fmt: skip
    """Write the single events among BLOCK_WORDS words, each with the row and the TIME_LOW in force before it.

    Only for processors that have `COMPRESSES`. 32 places of the arrays are touched.

    words: (N,) uint16, EVT3 words.
    _i: Index of the first word, uint64.
    _found: Which of the words are events to write, a bit each, uint64.
    _t: Clock before the first word, us, int64.
    _row: Row before the first word, px, int64.
    t_out, x_out, y_out, p_out: (M,) int64, uint16, uint16 and uint8, filled in: times (us), columns and rows
      (px), and polarities.
    _n: Index of the first event to write, uint64.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector, kinds = ir.VectorType(_WORD, BLOCK_WORDS), signature.args
        mask = ir.VectorType(_BIT, BLOCK_WORDS)
        words = builder.load(_address(context, builder, kinds[0], args[0], args[1], vector), align=1)
        found = builder.bitcast(builder.trunc(args[2], ir.IntType(BLOCK_WORDS)), mask)
        low_now = builder.and_(args[3], ir.Constant(_LONG, 0xFFF))
        upper = builder.and_(args[3], ir.Constant(_LONG, -4096))
        rows, lows = _in_force(builder, words, args[4], low_now)
        events, rows, lows = (_moved_together(builder, one, found) for one in (words, rows, lows))
        columns = builder.and_(events, _many(0x7FF))
        polarities = builder.and_(builder.lshr(events, _many(11)), _many(1))
        times = builder.zext(lows, ir.VectorType(_LONG, BLOCK_WORDS))
        times = builder.or_(times, _splat(builder, upper, BLOCK_WORDS))
        polarities = builder.trunc(polarities, ir.VectorType(_BYTE, BLOCK_WORDS))
        for k, values in enumerate((times, columns, rows, polarities)):
            place = _address(context, builder, kinds[5 + k], args[5 + k], args[9], values.type)
            builder.store(values, place, align=1)
        return context.get_dummy_value()

    number = types.int64
    return types.none(
        words, types.uint64, types.uint64, number, number, t_out, x_out, y_out, p_out, types.uint64
    ), generate


@intrinsic
def four_words(_typing: Any, words: Any, _i: Any) -> Any:
    """Return four words as one uint64, the first in its lowest bits.

    words: (N,) uint16, EVT3 words.
    _i: Index of the first word, uint64.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.load(_address(context, builder, signature.args[0], args[0], args[1], _LONG), align=1)

    return types.uint64(words, types.uint64), generate


@intrinsic
def copy_single_events(_typing: Any, words: Any, _i: Any, x_out: Any, p_out: Any, _n: Any) -> Any:
    """Write column and polarity of BLOCK_WORDS single events from word i on to the arrays from index n on.

    words: (N,) uint16, EVT3 words.
    _i: Index of the first word, uint64.
    x_out, p_out: (M,) uint16 and (M,) uint8, filled in: columns (px) and polarities.
    _n: Index of the first event to write, uint64.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector, narrow = ir.VectorType(_WORD, BLOCK_WORDS), ir.VectorType(_BYTE, BLOCK_WORDS)
        kinds = signature.args
        words = builder.load(_address(context, builder, kinds[0], args[0], args[1], vector), align=1)
        x = builder.and_(words, _many(0x7FF))
        p = builder.trunc(builder.and_(builder.lshr(words, _many(11)), _many(1)), narrow)
        builder.store(x, _address(context, builder, kinds[2], args[2], args[4], vector), align=1)
        builder.store(p, _address(context, builder, kinds[3], args[3], args[4], narrow), align=1)
        return context.get_dummy_value()

    return types.none(words, types.uint64, x_out, p_out, types.uint64), generate


@intrinsic
def _write_columns(_typing: Any, table: Any, _byte: Any, _x: Any, x_out: Any, _n: Any) -> Any:
    """Write the eight columns that the table has for a byte, counted from column x, from index n on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        wide, narrow = ir.VectorType(_WORD, 8), ir.VectorType(_BYTE, 8)
        kinds = signature.args
        first = builder.mul(args[1], ir.Constant(_LONG, 8))
        places = builder.load(_address(context, builder, kinds[0], args[0], first, narrow), align=1)
        base = _splat(builder, builder.trunc(args[2], _WORD), 8)
        columns = builder.add(builder.zext(places, wide), base)
        builder.store(columns, _address(context, builder, kinds[3], args[3], args[4], wide), align=1)
        return context.get_dummy_value()

    return types.none(table, types.uint64, types.int64, x_out, types.uint64), generate


@intrinsic
def _write_columns_at_once(_typing: Any, _bits: Any, _x: Any, x_out: Any, _n: Any) -> Any:
    """Write the columns of up to 32 bits, counted from column x, from index n on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector = ir.VectorType(_WORD, BLOCK_WORDS)
        bits = builder.trunc(args[0], ir.IntType(BLOCK_WORDS))
        chosen = builder.bitcast(bits, ir.VectorType(_BIT, BLOCK_WORDS))
        places = _moved_together(builder, ir.Constant(vector, [*range(BLOCK_WORDS)]), chosen)
        columns = builder.add(places, _splat(builder, builder.trunc(args[1], _WORD), BLOCK_WORDS))
        place = _address(context, builder, signature.args[2], args[2], args[3], vector)
        builder.store(columns, place, align=1)
        return context.get_dummy_value()

    return types.none(types.uint64, types.int64, x_out, types.uint64), generate


@njit(**JIT, forceinline=True)
def write_columns(x_out: Any, n: Any, x: Any, bits: Any) -> None:
    """Write the columns of the bits that are set, lowest first; 32 places are touched.

    x_out: (N,) uint16, columns to fill, px.
    n: Index of the first column to write, uint64.
    x: Column of the lowest bit, px, int64.
    bits: One bit a column, uint64 below 2^32.
    """
    if COMPRESSES:
        _write_columns_at_once(bits, x, x_out, n)
        return
    for k in range(4):
        byte = (bits >> np.uint64(8 * k)) & np.uint64(0xFF)
        _write_columns(_COLUMNS, byte, x + 8 * k, x_out, n)
        n += count_ones(byte)
