import numba
from numba.extending import overload

from sonoservo.systems.evaluation.compile_free_clock import CompileFreeClock


class Stopwatch:
    """A clock that stands still until somebody advances it."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


def test_compilation_is_left_out():
    stopwatch = Stopwatch()

    def compile_slowly(x):
        """Do nothing; it takes a second to be compiled for each type of its argument."""

    @overload(compile_slowly)
    def compile_for_type(x):
        stopwatch.now += 1.0
        return lambda x: None

    @numba.njit
    def inner(x):
        compile_slowly(x)
        return 2 * x

    @numba.njit
    def outer(x):
        result = inner(x) + 1
        compile_slowly(result + 0.5)
        return result

    clock = CompileFreeClock(stopwatch)
    with clock:
        assert outer(3) == 7
        assert clock.compiled == 2.0  # a second for each kernel: one compiles the other
        assert clock() == 0.0
        stopwatch.now += 3.0
        assert outer(4) == 9
        assert clock.compiled == 2.0
        assert clock() == 3.0
    assert outer(1j) == 1 + 2j
    assert stopwatch.now == 6.0
    assert clock.compiled == 2.0
