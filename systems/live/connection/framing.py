"""From the bytes of an OpenIGTLink connection to whole messages: headers, sizes, checksums.

Nothing here opens a socket or waits, so every kind of damage can be tested without one.
"""

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

HEADER_SIZE = 58
MAX_BODY = 1 << 28
"""Most bytes of a body that is kept; a volume of 400 x 400 x 400 float32 numbers fits."""

_MAX_SKIPPED = 1 << 32  # Most bytes of a body that is skipped; a header that announces more is none
# Bytes reserved for a body at first; what is reserved doubles as they arrive.
_FIRST_PIECE = 1 << 20
_HEADER = struct.Struct("> H 12s 20s I I Q Q")
_EXTENDED = struct.Struct("> H H I I")
_VERSIONS = (1, 2, 3)  # Version 3 is laid out as version 2 is
_FRACTION = 1 << 32  # The second half of a time stamp counts in these parts of a second
# Time in s that a message may take, and how many bytes a second prolong it.
_HEADER_PATIENCE, _SLOWEST = 5.0, 1e6


class FramingError(Exception):
    """The bytes are no OpenIGTLink any more: where the next message begins is not known."""


class MessageError(Exception):
    """A message whose content makes no sense; the connection can go on."""


@dataclass(frozen=True)
class Header:
    """Header of a message: its time in s, and size and checksum of its body in bytes."""

    version: int
    type: str
    device: str
    time: float
    size: int
    crc: int


@dataclass(frozen=True)
class Frame:
    """A whole message; its content is None if it was skipped, for a fault or its type."""

    header: Header
    content: memoryview | None
    fault: str = ""

    def __str__(self) -> str:
        return self.header.type


def parse_header(data: bytes | bytearray) -> Header:
    """Read a header; any type is taken, as the size is all that is needed to skip a message."""
    version, kind, device, seconds, fraction, size, crc = _HEADER.unpack(data)
    name, text = (
        each.partition(b"\0")[0].decode("utf-8", "replace").strip() for each in (kind, device)
    )
    if version not in _VERSIONS or not name or size > _MAX_SKIPPED:
        raise FramingError(f"not OpenIGTLink: version {version}, type {name!r}, {size} bytes")
    return Header(version, name, text, seconds + fraction / _FRACTION, size, crc)


def pack_frame(kind: str, device: str, time: float, content: bytes) -> bytes:
    """Return a message of version 1; kind and device have at most 12 and 20 bytes, time is in s."""
    name = device.encode()
    if not 0 < len(name) <= 20:
        raise ValueError(f"name: {device!r} is not allowed; it must be 1 to 20 bytes long")
    if not 0 <= time < 1 << 32:
        raise ValueError(f"time: {time!r} is not allowed; it must be from 0 to 2^32 s")
    seconds, fraction = divmod(round(time * _FRACTION), _FRACTION)
    head = _HEADER.pack(1, kind.encode(), name, seconds, fraction, len(content), crc64(content))
    return head + content


class Framer:
    """Cuts the bytes of one connection into messages of the wanted types and sizes."""

    def __init__(self, wanted: Mapping[str, int]) -> None:
        self._wanted = wanted
        self._scrap = memoryview(bytearray(1 << 16))
        self._begin()

    def _begin(self) -> None:
        self._header: Header | None = None
        self._target = memoryview(bytearray(HEADER_SIZE))
        self._filled = self._crc = 0
        self._since: float | None = None

    @property
    def _kept(self) -> bool:
        header = self._header
        return header is None or header.size <= self._wanted.get(header.type, -1)

    @property
    def held(self) -> int:
        """Bytes of memory reserved for the message that is under way."""
        return len(self._target) if self._header is not None else 0

    @property
    def buffer(self) -> memoryview:
        """Memory that takes the next bytes."""
        if self._header is not None and not self._kept:
            return self._scrap[: self._header.size - self._filled]
        return self._target[self._filled :][: 1 << 18]

    def is_overdue(self, now: float) -> bool:
        """Return whether too little has come of the message under way, at a time in s."""
        if self._since is None:
            return False
        return now - self._since > _HEADER_PATIENCE + self._filled / _SLOWEST

    def advance(self, count: int, now: float) -> Iterator[Frame]:
        """Take in ``count`` bytes of `buffer`; yield the message that they complete, if any."""
        if self._since is None:
            self._since = now
        if self._header is not None:
            self._crc = crc64(self.buffer[:count], self._crc)
        self._filled += count
        if self._header is None:
            if self._filled < HEADER_SIZE:
                return
            self._header = parse_header(bytes(self._target))
            self._filled, self._target = 0, memoryview(b"")
        header = self._header
        if self._filled < header.size:
            if self._kept and self._filled == len(self._target):
                self._grow(min(header.size, max(2 * self._filled, _FIRST_PIECE)))
            return
        body, crc, kept = self._target, self._crc, self._kept
        self._begin()
        if kept and crc != header.crc:
            yield Frame(header, None, "the checksum is wrong")
        elif kept:
            yield _cut_frame(header, body)
        elif header.type in self._wanted:
            most = self._wanted[header.type]
            yield Frame(header, None, f"{header.size} bytes; at most {most} are taken")
        else:
            yield Frame(header, None)

    def _grow(self, size: int) -> None:
        larger = memoryview(np.empty(size, np.uint8).data)
        larger[: self._filled] = self._target
        self._target = larger


def _cut_frame(header: Header, body: memoryview) -> Frame:
    """Return the content between an extended header and metadata, if there are any."""
    if header.version == 1:
        return Frame(header, body)
    if len(body) < _EXTENDED.size:
        return Frame(header, None, "it is too short for its extended header")
    extended, keys, values, _ = _EXTENDED.unpack(body[: _EXTENDED.size])
    end = len(body) - keys - values
    if not _EXTENDED.size <= extended <= end:
        return Frame(header, None, "the sizes in its extended header are wrong")
    return Frame(header, body[extended:end])


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
