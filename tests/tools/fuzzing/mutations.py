"""Seeded damage to the bytes of a valid file."""

import gzip
import re
import struct
import zlib
from random import Random

NUMBERS = [
    "-1", "0", "1", "2", "0.5", "-0.0", "nan", "inf", "-inf", "1e-300", "1e-9", "1e9", "1e30",
    "1e39", "1e300", "1e400", "255", "256", "65536", "2147483648", "4294967296", "9" * 19,
    "9" * 40, "9" * 5000, "1_000", "0x10", "1.5.2", "--3", "",
]  # fmt: skip
WORDS = [
    "none", "None", "true", "LOCAL", "LIST", "LISTFILE", "gzip", "raw", "ascii", "hex", "bz2",
    "double", "float", "uint8", "uint64", "block", "MET_DOUBLE", "MET_UCHAR_ARRAY", "(", ")", "[",
    "]", "{", "}", ":", ":=", "=", ",", '"', "'", "\n", "\n\n", "\0", "\t", " ", "../../etc/passwd",
    "/dev/zero", "/dev/null", "%d", "RAS", "scanner-xyz", "[/bold]", "\x1b[31m", "é", "\udcff",
]  # fmt: skip
_NUMBER = re.compile(rb"-?\d+\.?\d*(?:e[+-]?\d+)?")
_WORD = re.compile(rb"[A-Za-z_]{2,}|[=:,()\[\]{}\"]")


def text(rng: Random) -> bytes:
    """Return a number or word that may be anything but what is expected."""
    return rng.choice(rng.choice([NUMBERS, WORDS])).encode("utf-8", "surrogateescape")


def mutate(content: bytes, header: int, rng: Random) -> tuple[bytes, str]:
    """Return the damaged content of a valid file, and what was done to it.

    ``header`` is the number of bytes at the start that describe the others; 0 if all do.
    """
    said = []
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        kind = rng.choice(_KINDS)
        content = kind(content, min(header or len(content), len(content)), rng)
        said.append(kind.__name__)
    return content, "+".join(said)


def truncated(content: bytes, header: int, rng: Random) -> bytes:
    return content[: rng.randrange(len(content) + 1)]


def flipped(content: bytes, header: int, rng: Random) -> bytes:
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 4, 30])):
        if data:
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return bytes(data)


def flipped_header(content: bytes, header: int, rng: Random) -> bytes:
    return flipped(content[:header], header, rng) + content[header:]


def number_replaced(content: bytes, header: int, rng: Random) -> bytes:
    found = list(_NUMBER.finditer(content, 0, header))
    return _replaced(content, found, rng.choice(NUMBERS).encode(), rng)


def word_replaced(content: bytes, header: int, rng: Random) -> bytes:
    return _replaced(content, list(_WORD.finditer(content, 0, header)), text(rng), rng)


def inserted(content: bytes, header: int, rng: Random) -> bytes:
    at, gone = rng.randrange(header + 1), rng.choice([0, 0, 1, 5, 40])
    new = rng.choice([text(rng), rng.randbytes(rng.choice([1, 3, 20])), b"[" * 400, b"9" * 5000])
    return content[:at] + new + content[at + gone :]


def line_moved(content: bytes, header: int, rng: Random) -> bytes:
    lines = content[:header].splitlines(keepends=True)
    if not lines:
        return content
    line = rng.choice(lines)
    if rng.random() < 0.5:
        lines.remove(line)
    if rng.random() < 0.5:
        lines.insert(rng.randrange(len(lines) + 1), line)
    return b"".join(lines) + content[header:]


def repeated(content: bytes, header: int, rng: Random) -> bytes:
    return content[:header] + content[rng.randrange(header + 1) :]


def packed(content: bytes, header: int, rng: Random) -> bytes:
    data = content[header:]
    pack = rng.choice([gzip.compress, zlib.compress])
    return content[:header] + pack(data)


def many_zeros(content: bytes, header: int, rng: Random) -> bytes:
    """A bomb: the data are replaced by up to 64 MB of zeros, packed to a thousandth."""
    pack = zlib.compressobj(9, wbits=rng.choice([15, 31]))
    pieces = [pack.compress(bytes(1 << 20)) for _ in range(rng.choice([1, 8, 64]))]
    return content[:header] + b"".join(pieces) + pack.flush()


def absurd_values(content: bytes, header: int, rng: Random) -> bytes:
    """Doubles beyond single precision, NaN or infinity, over the data."""
    value = struct.pack("<d", rng.choice([1e300, -1e300, float("nan"), float("inf"), 1e-310]))
    data = bytearray(content[header:])
    for _ in range(rng.choice([1, 3])):
        at = 8 * rng.randrange(len(data) // 8 + 1)
        data[at : at + 8] = value
    return content[:header] + bytes(data)


def _replaced(content: bytes, found: list[re.Match[bytes]], new: bytes, rng: Random) -> bytes:
    if not found:
        return content
    match = rng.choice(found)
    return content[: match.start()] + new + content[match.end() :]


_KINDS = [
    truncated, flipped, flipped_header, *4 * [number_replaced], *2 * [word_replaced], inserted,
    line_moved, repeated, packed, many_zeros, absurd_values,
]  # fmt: skip
