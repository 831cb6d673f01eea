"""Options that the compiled kernels share, and the hash that breaks ties."""

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

OPTIONS = {"cache": True, "error_model": "numpy", "nogil": True}
"""Options of kernels: cached, without checks and without the GIL.

No fast arithmetic: reordered sums, fused products and approximate functions round differently on
each processor, and one grey level that flips changes every later choice.
"""

INNER = OPTIONS | {"_nrt": False}
"""Options of kernels that other kernels call, and that make no arrays.

They do not count references to the arrays that they read, which takes longer than the arithmetic.
"""


@njit(cache=True, nogil=True)
def scattered(index: Any) -> Any:  # pragma: no cover - compiled
    """Return a whole number below 2^32 for a voxel's flat index, without pattern in space.

    Of equal voxels, those with the smallest number are taken. That prefers no part of the volume,
    and unlike a random draw, one tie more or less changes no other choice. No two indices below
    2^32 have the same number (the finalizer of MurmurHash3, Appleby 2011).
    """
    number = np.uint64(index)
    for shift, factor in ((16, 0x85EBCA6B), (13, 0xC2B2AE35), (16, 1)):
        number ^= number >> np.uint64(shift)
        number = (number * np.uint64(factor)) & np.uint64(0xFFFFFFFF)
    return number


@njit(cache=True, nogil=True)
def _all_scattered(index: Any) -> Any:  # pragma: no cover - compiled
    numbers = np.empty(len(index), np.uint64)
    for n in range(len(index)):
        numbers[n] = scattered(index[n])
    return numbers


def chosen_ties(index: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Return ``count`` of the (m,) flat indices of equal voxels, by `scattered`, in their order."""
    if not 0 < count < len(index):
        return index[:count]
    numbers = _all_scattered(index)
    return index[numbers <= np.partition(numbers, count - 1)[count - 1]]
