import numba

from sonoservo.systems.evaluation.compile_free_clock import CompileFreeClock


class Ticking:
    """A clock that advances by one second at every reading."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        self.now += 1.0
        return self.now


def test_compilation_is_left_out():
    @numba.njit
    def inner(x):
        return 2 * x

    @numba.njit
    def outer(x):
        return inner(x) + 1

    ticking = Ticking()
    clock = CompileFreeClock(ticking)
    with clock:
        start = clock()
        assert outer(3) == 7
        assert clock() - start == 1.0  # the tick of this reading
        assert clock.compiled == 1.0  # of the outer kernel: the inner one is part of it
        assert outer(4) == 9
        assert clock.compiled == 1.0
    outer(1.5)
    assert clock.compiled == 1.0
