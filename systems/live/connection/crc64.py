"""The 64-bit checksum of OpenIGTLink, fast and without holding up other threads."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

# CRC-64/ECMA-182: most significant bit first, starts at 0, nothing is inverted.
_POLYNOMIAL = 0x42F0E1EBA9EA3693


def _make_tables() -> NDArray[np.uint64]:
    """Return (8, 256) tables: row k advances a byte by k further bytes of zeros."""
    first = []
    for byte in range(256):
        crc = byte << 56
        for _ in range(8):
            crc = (crc << 1 ^ (_POLYNOMIAL if crc >> 63 else 0)) & (1 << 64) - 1
        first.append(crc)
    rows = [first]
    for _ in range(7):
        rows.append([(crc << 8 & (1 << 64) - 1) ^ first[crc >> 56] for crc in rows[-1]])
    return np.array(rows, np.uint64)


_TABLES = _make_tables()


def crc64(data: bytes | bytearray | memoryview, crc: int = 0) -> int:
    """Return the checksum of contiguous bytes, going on from that of those before them."""
    return int(_crc64(np.frombuffer(data, np.uint8), np.uint64(crc), _TABLES)) if len(data) else crc


@njit(cache=True, nogil=True)
def _crc64(data, crc, tables):  # type: ignore[no-untyped-def]
    """Eight bytes at a time ("slicing by 8", Kounavis and Berry 2005)."""
    eight, low = np.uint64(8), np.uint64(0xFF)
    blocks = len(data) // 8
    for block in range(blocks):
        word = np.uint64(0)
        for byte in range(8):
            word = word << eight | np.uint64(data[8 * block + byte])
        word ^= crc
        crc = tables[0, word & low]
        for row in range(1, 8):
            word >>= eight
            crc ^= tables[row, word & low]
    for at in range(8 * blocks, len(data)):
        crc = crc << eight ^ tables[0, crc >> np.uint64(56) ^ np.uint64(data[at])]
    return crc
