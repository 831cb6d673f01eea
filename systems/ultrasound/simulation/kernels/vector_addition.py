"""Vectorised addition of pulses to lines, which the compiler does not vectorise by itself."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.extending import intrinsic

from sonoservo.systems.sampling.kernels import INNER
from sonoservo.systems.ultrasound.simulation.kernels.projection import FRACTIONS

LANES = 8
"""Number of floats that are added at a time: four complex numbers."""

_HALF = np.float32(0.5)
_THREE_QUARTERS = np.float32(0.75)
_FRACTIONS = np.float32(FRACTIONS)


def _vector() -> Any:
    """Return the type of `LANES` floats."""
    return ir.VectorType(ir.FloatType(), LANES)


def _piece(context: Any, builder: Any, kind: Any, values: Any, index: Any) -> Any:
    """Return the pointer to `LANES` numbers of a contiguous float32 array, by its flat index."""
    data = cgutils.create_struct_proxy(kind)(context, builder, value=values).data
    return builder.bitcast(builder.gep(data, [index]), _vector().as_pointer())


def _spread(builder: Any, *values: Any) -> Any:
    """Return a vector that repeats values."""
    result = ir.Constant(_vector(), ir.Undefined)
    for lane in range(LANES):
        position = ir.Constant(ir.IntType(32), lane)
        result = builder.insert_element(result, values[lane % len(values)], position)
    return result


# Neither function has "fast" arithmetic, which some processors would fuse.


@intrinsic
def _add_to_rows(  # type: ignore[no-untyped-def]
    typing_context, rows, at, width, table, start, real, imaginary, below, here, above
):
    """Add an envelope, every value twice, times an amplitude, to three rows at given weights.

    With ``a = (real, imaginary, real, imaginary, ...)`` and ``n = 0 .. LANES - 1``, at flat indices
    of contiguous float32 arrays, unchecked: ``rows[at + n] += a[n] * table[start + n] * below``,
    and so on with ``here`` and ``above``, each ``width`` numbers further on.
    """
    number, scalar = types.int64, types.float32
    signature = types.none(
        rows, number, number, table, number, scalar, scalar, scalar, scalar, scalar
    )

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        rows, at, width, table, start, real, imaginary, *weights = arguments
        pulse = builder.load(_piece(context, builder, kinds[3], table, start), align=4)
        echo = builder.fmul(pulse, _spread(builder, real, imaginary))
        for weight in weights:
            row = _piece(context, builder, kinds[0], rows, at)
            product = builder.fmul(echo, _spread(builder, weight))
            total = builder.fadd(builder.load(row, align=4), product)
            builder.store(total, row, align=4)
            at = builder.add(at, width)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def _add_to_row(typing_context, rows, at, table, start, real, imaginary):  # type: ignore[no-untyped-def]
    """Add a complex pulse times a complex amplitude to a row, real and imaginary parts alternating.

    As `_add_to_rows`: ``rows[at + n] += (real + i imaginary) * table[start + n]``.
    """
    number, scalar = types.int64, types.float32
    signature = types.none(rows, number, table, number, scalar, scalar)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kinds = signature.args
        rows, at, table, start, real, imaginary = arguments
        pulse = builder.load(_piece(context, builder, kinds[2], table, start), align=4)
        order = [ir.Constant(ir.IntType(32), lane ^ 1) for lane in range(LANES)]
        swapped = builder.shuffle_vector(
            pulse,
            ir.Constant(_vector(), ir.Undefined),
            ir.Constant(ir.VectorType(ir.IntType(32), LANES), order),
        )
        negative = builder.fneg(imaginary)
        echo = builder.fadd(
            builder.fmul(pulse, _spread(builder, real)),
            builder.fmul(swapped, _spread(builder, negative, imaginary)),
        )
        row = _piece(context, builder, kinds[0], rows, at)
        builder.store(builder.fadd(builder.load(row, align=4), echo), row, align=4)
        return context.get_dummy_value()

    return signature, generate


@njit(**INNER)
def add_pulse(layer, line, sample, pulse, row, width, real, imaginary):  # type: ignore[no-untyped-def]
    """Add a row of a table of pulses times a complex amplitude to a line, from a sample on.

    Layer and table are 2D float32, real and imaginary parts alternating; ``width`` is that of the
    pulse.
    """
    at = line * layer.shape[1] + 2 * sample
    start = row * pulse.shape[1]
    for _ in range(width // LANES):
        _add_to_row(layer, at, pulse, start, real, imaginary)
        at += LANES
        start += LANES


@njit(**INNER)
def deposit(accumulator, chosen, count, line, sample, cosine, sine, pulse):  # type: ignore[no-untyped-def]
    """Add the chosen scatterers to three lines each, eight numbers (four complex taps) at a time.

    Line, sample, cosine and sine are (n,) float32 coordinates and amplitudes, ``pulse`` the
    envelope of `Scattering`.
    """
    width = accumulator.shape[1]
    chunks = pulse.shape[1] // LANES
    for number in range(count):
        i = chosen[number]
        re = cosine[i]
        im = sine[i]
        j = np.int32(line[i] + _HALF)
        k = np.int32(sample[i])
        fraction = np.int32((sample[i] - np.float32(k)) * _FRACTIONS + _HALF)
        t = line[i] - np.float32(j)
        below = _HALF * (_HALF - t) * (_HALF - t)
        above = _HALF * (_HALF + t) * (_HALF + t)
        here = _THREE_QUARTERS - t * t
        for chunk in range(chunks):
            _add_to_rows(
                accumulator,
                (j - 1) * width + 2 * k + LANES * chunk,
                width,
                pulse,
                fraction * pulse.shape[1] + LANES * chunk,
                re,
                im,
                below,
                here,
                above,
            )
