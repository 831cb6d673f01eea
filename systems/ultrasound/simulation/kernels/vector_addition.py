"""Vectorised addition to three rows, which the compiler does not vectorise by itself."""

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba.core import cgutils, types
from numba.extending import intrinsic

LANES = 8
"""Number of floats that `add_to_rows` processes at a time: four complex numbers."""


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

        def multiply(a: Any, b: Any) -> Any:
            return builder.fmul(a, b, flags=("fast",))

        pulse = builder.load(piece(table, start), align=4)
        echo = multiply(pulse, spread(real, imaginary))
        for weight in weights:
            row = piece(rows, at)
            product = multiply(echo, spread(weight))
            total = builder.fadd(builder.load(row, align=4), product, flags=("fast",))
            builder.store(total, row, align=4)
            at = builder.add(at, width)
        return context.get_dummy_value()

    return signature, generate
