"""Vectorised addition of pulses to three rows, which the compiler does not vectorise by itself."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.extending import intrinsic

from sonoservo.systems.sampling.kernels import OPTIONS
from sonoservo.systems.ultrasound.simulation.kernels.projection import FRACTIONS

LANES = 8
"""Number of floats that `add_to_rows` processes at a time: four complex numbers."""

_HALF = np.float32(0.5)
_THREE_QUARTERS = np.float32(0.75)
_FRACTIONS = np.float32(FRACTIONS)


@intrinsic
def add_to_rows(  # type: ignore[no-untyped-def]
    typing_context, rows, at, width, table, start, real, imaginary, below, here, above
):
    """Add a piece of a pulse, times a complex amplitude, to three neighbouring rows.

    With ``a = (real, imaginary, real, imaginary, ...)`` and ``n = 0 .. LANES - 1``::

        rows[at + n] += below * a[n] * table[start + n]
        rows[at + width + n] += here * a[n] * table[start + n]
        rows[at + 2 * width + n] += above * a[n] * table[start + n]

    Parameters
    ----------
    rows, table
        1D float32 arrays, accessed without checks of their bounds.
    at, width, start
        int64 index of the first row's piece, distance between rows, and index into the table.
    real, imaginary, below, here, above
        float32 parts of the amplitude, and weights of the three rows.
    """
    array = types.Array(types.float32, 1, "C")
    number, scalar = types.int64, types.float32
    signature = types.none(
        array, number, number, array, number, scalar, scalar, scalar, scalar, scalar
    )

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        rows, at, width, table, start, real, imaginary, *weights = arguments
        vector = ir.VectorType(ir.FloatType(), LANES)

        def piece(values: Any, index: Any) -> Any:
            data = cgutils.create_struct_proxy(array)(context, builder, value=values).data
            return builder.bitcast(builder.gep(data, [index]), vector.as_pointer())

        def spread(*values: Any) -> Any:
            result = ir.Constant(vector, ir.Undefined)
            for lane in range(LANES):
                position = ir.Constant(ir.IntType(32), lane)
                result = builder.insert_element(result, values[lane % len(values)], position)
            return result

        # No "fast" arithmetic, which some processors would fuse.
        pulse = builder.load(piece(table, start), align=4)
        echo = builder.fmul(pulse, spread(real, imaginary))
        for weight in weights:
            row = piece(rows, at)
            product = builder.fmul(echo, spread(weight))
            total = builder.fadd(builder.load(row, align=4), product)
            builder.store(total, row, align=4)
            at = builder.add(at, width)
        return context.get_dummy_value()

    return signature, generate


@njit(**OPTIONS)
def deposit(accumulator, chosen, count, line, sample, cosine, sine, pulse):  # type: ignore[no-untyped-def]
    """Add projected scatterers to three lines each, eight numbers (four complex taps) at a time.

    Parameters
    ----------
    accumulator
        (lines, 2 samples) float32, real and imaginary parts alternating, added to.
    chosen, count
        Indices of the scatterers, and the number of valid ones.
    line, sample, cosine, sine
        (n,) float32 coordinates and complex amplitudes of the scatterers.
    pulse
        (FRACTIONS + 1, 2 taps) float32 envelope, every value twice.
    """
    width = accumulator.shape[1]
    flat = accumulator.reshape(-1)
    table = pulse.reshape(-1)
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
            add_to_rows(
                flat,
                (j - 1) * width + 2 * k + LANES * chunk,
                width,
                table,
                fraction * pulse.shape[1] + LANES * chunk,
                re,
                im,
                below,
                here,
                above,
            )
