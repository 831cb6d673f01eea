"""Addresses of live connections."""

import re
from dataclasses import dataclass

from sonoservo.systems.files.refusals import ConfigurationError

SCHEME, DEFAULT_PORT = "igtl", 18944
"""Scheme of an address, and the port unless it states one."""

_ADDRESS = re.compile(r"(\w+)://(\[[0-9a-fA-F:.]+\]|[^/:\s]*)(?::(\d{1,5}))?(?:/(.{0,20}))?")


@dataclass(frozen=True)
class Address:
    """Address to connect to, or to listen on: for this machine alone if the host is empty."""

    host: str
    port: int
    device: str = ""

    @property
    def listens(self) -> bool:
        """True if others connect to us."""
        return self.host in ("", "0.0.0.0", "::")

    @property
    def bound(self) -> tuple[str, int]:
        """Host and port of the socket."""
        return (self.host or "127.0.0.1", self.port)

    @property
    def file_name(self) -> str:
        """Name for files about what comes from it."""
        return f"{self.host.replace(':', '_') or 'localhost'}_{self.port}"

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{SCHEME}://{host}:{self.port}"


def is_address(text: str) -> bool:
    """Return whether a text is meant as the address of a live connection, and not as a file."""
    return "://" in text


def parse_address(text: str) -> Address:
    """Read an address: ``igtl://host:18944/DEVICE``, or ``igtl://:18944`` to listen."""
    match = _ADDRESS.fullmatch(text)
    if match is None or int(match[3] or 0) > 65535:
        raise ConfigurationError(
            f"{text!r} is no address; igtl://host:18944/DEVICE connects, igtl://:18944 listens"
        )
    scheme, host, port, device = match.groups()
    if scheme != SCHEME:
        raise ConfigurationError(f"unknown protocol {scheme!r}; known: {SCHEME}")
    return Address(host.strip("[]"), int(port or DEFAULT_PORT), device or "")
