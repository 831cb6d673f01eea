"""From the bytes of an OpenIGTLink connection to whole messages: headers, sizes, checksums.

Nothing here opens a socket or waits, so every kind of damage can be tested without one.
"""

import re
import struct
from collections.abc import Container, Iterator
from dataclasses import dataclass

from sonoservo.systems.live.connection.crc64 import crc64

HEADER_SIZE = 58
MAX_BODY = 1 << 28
"""Bytes; a volume of 400 x 400 x 400 float32 numbers fits."""

_HEADER = struct.Struct("> H 12s 20s I I Q Q")
_EXTENDED = struct.Struct("> H H I I")
_TYPE = re.compile(rb"[A-Z][A-Z0-9_]*")
_VERSIONS = (1, 2)
_FRACTION = 1 << 32
"""The second half of a time stamp counts in these parts of a second."""

_HEADER_PATIENCE, _SLOWEST = 5.0, 1e6
"""Longest time for a header, in s, and least bytes per second for a body."""


class FramingError(Exception):
    """The bytes are no OpenIGTLink any more: where the next message begins is not known."""


class MessageError(Exception):
    """A message whose content makes no sense; the connection can go on."""


@dataclass(frozen=True)
class Header:
    """Header of a message.

    Parameters
    ----------
    version
        1, or 2 with an extended header and metadata.
    type, device
        For example ``IMAGE`` and ``Image_Probe``.
    time
        Time in s.
    size
        Bytes of the body.
    crc
        Checksum of the body.
    """

    version: int
    type: str
    device: str
    time: float
    size: int
    crc: int


@dataclass(frozen=True)
class Frame:
    """A whole message.

    Parameters
    ----------
    header
        Header of the message.
    content
        Its body without extended header and metadata; None if the message was skipped.
    fault
        Why it was skipped; empty if the type is not wanted.
    """

    header: Header
    content: memoryview | None
    fault: str = ""


def parse_header(data: bytes | bytearray, max_body: int = MAX_BODY) -> Header:
    """Read a header.

    Raises
    ------
    FramingError
        If it cannot be one, or announces a body of more than ``max_body`` bytes.
    """
    version, kind, device, seconds, fraction, size, crc = _HEADER.unpack(data)
    name = kind.rstrip(b"\0 ")
    if version not in _VERSIONS or not _TYPE.fullmatch(name):
        raise FramingError(f"not OpenIGTLink: version {version}, type {name!r}")
    if size > max_body:
        raise FramingError(f"a {name.decode()} of {size} bytes; at most {max_body} are taken")
    text = device.partition(b"\0")[0].decode("utf-8", "replace").strip()
    return Header(version, name.decode(), text, seconds + fraction / _FRACTION, size, crc)


def pack_frame(kind: str, device: str, time: float, content: bytes) -> bytes:
    """Return a message of version 1.

    Parameters
    ----------
    kind, device
        At most 12 and 20 bytes.
    time
        Time in s, from 0 to 2^32.
    content
        Its body.

    Raises
    ------
    ValueError
        If the name is too long, or the time is out of range.
    """
    name = device.encode()
    if not 0 < len(name) <= 20:
        raise ValueError(f"name: {device!r} is not allowed; it must be 1 to 20 bytes long")
    if not 0 <= time < 1 << 32:
        raise ValueError(f"time: {time!r} is not allowed; it must be from 0 to 2^32 s")
    seconds, fraction = divmod(round(time * _FRACTION), _FRACTION)
    head = _HEADER.pack(1, kind.encode(), name, seconds, fraction, len(content), crc64(content))
    return head + content


class Framer:
    """Cuts the bytes of one connection into messages.

    Read into `buffer`, then call `advance` with the number of bytes and the time.

    Parameters
    ----------
    wanted
        Types whose bodies are kept; others are skipped without being stored.
    max_body
        Most bytes of a body.
    """

    def __init__(self, wanted: Container[str], *, max_body: int = MAX_BODY) -> None:
        self._wanted, self._max_body = wanted, max_body
        self._scrap = memoryview(bytearray(1 << 16))
        self._begin()

    def _begin(self) -> None:
        self._header: Header | None = None
        self._target = memoryview(bytearray(HEADER_SIZE))
        self._filled = self._crc = 0
        self._since: float | None = None

    @property
    def buffer(self) -> memoryview:
        """Memory that takes the next bytes."""
        if self._header is not None and self._header.type not in self._wanted:
            return self._scrap[: self._header.size - self._filled]
        return self._target[self._filled :][: 1 << 18]

    def is_overdue(self, now: float) -> bool:
        """Return whether the message that is under way takes too long, at a time in s."""
        if self._since is None:
            return False
        size = self._header.size if self._header is not None else 0
        return now - self._since > _HEADER_PATIENCE + size / _SLOWEST

    def advance(self, count: int, now: float) -> Iterator[Frame]:
        """Take in ``count`` bytes of `buffer`; yield the message that they complete, if any.

        Raises
        ------
        FramingError
            If the connection can no longer be understood.
        """
        if self._since is None:
            self._since = now
        if self._header is not None:
            self._crc = crc64(self.buffer[:count], self._crc)
        self._filled += count
        if self._header is None:
            if self._filled < HEADER_SIZE:
                return
            self._header = parse_header(bytes(self._target), self._max_body)
            self._filled = 0
            kept = self._header.size if self._header.type in self._wanted else 0
            self._target = memoryview(bytearray(kept))
        header = self._header
        if self._filled < header.size:
            return
        body, crc = self._target, self._crc
        self._begin()
        if crc != header.crc:
            yield Frame(header, None, "the checksum is wrong")
        elif header.type not in self._wanted:
            yield Frame(header, None)
        else:
            yield _cut_frame(header, body)


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
