"""The protocols of live connections, and the addresses that name them."""

import re
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol, cast

from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import suggest
from sonoservo.systems.live.connection.items import Item

# Modules with what `LiveProtocol` describes, by the scheme of their addresses.
_PROTOCOLS = {"igtl": "sonoservo.systems.live.connection.open_igt_link"}
_ADDRESS = re.compile(r"(\w+)://(\[[0-9a-fA-F:.]+\]|[^/:\s]*)(?::(\d{1,5}))?(?:/(.{0,20}))?")


class LiveProtocol(Protocol):
    """Conversion of items to bytes and back."""

    DEFAULT_PORT: int

    def make_framer(self) -> Any:
        """Return what cuts the bytes of one connection into messages, as `Framer` does."""
        ...

    def encode(self, item: Item) -> bytes:
        """Return the message for an item."""
        ...

    def decode(self, frame: Any) -> list[Item]:
        """Return what a message holds."""
        ...


@dataclass(frozen=True)
class Address:
    """Address to connect to, or to listen on: for this machine alone if the host is empty.

    ``0.0.0.0`` and ``::`` listen on all networks. An empty device stands for any.
    """

    scheme: str
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
        return f"{self.scheme}://{host}:{self.port}"


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
    protocol = load_protocol(scheme)
    return Address(
        scheme, host.strip("[]"), protocol.DEFAULT_PORT if port is None else int(port), device or ""
    )


def load_protocol(scheme: str) -> LiveProtocol:
    """Return the protocol with a scheme; an error if it is unknown or needs a missing package."""
    if scheme not in _PROTOCOLS:
        raise ConfigurationError(f"unknown protocol {scheme!r}; {suggest(scheme, _PROTOCOLS)}")
    return cast(LiveProtocol, import_module(_PROTOCOLS[scheme]))
