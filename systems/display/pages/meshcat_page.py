"""Meshcat's page on a site: Drake's server is hidden, and reached through the site's rule alone."""

import asyncio
import base64
import logging
import secrets
import socket
from collections.abc import Callable
from contextlib import suppress
from mimetypes import guess_type
from typing import Any

from pydrake.geometry import Meshcat, MeshcatParams
from tornado.httpclient import AsyncHTTPClient
from tornado.iostream import IOStream, StreamClosedError
from tornado.netutil import Resolver
from tornado.tcpclient import TCPClient
from tornado.websocket import WebSocketHandler

from sonoservo.systems.display.pages.site import Guarded, Site

PATIENCE = 20.0
"""Time in s for which a page may leave what it was sent unread before it is disconnected."""

# Paths of Meshcat's server that are passed on.
_FILES = r"(|index\.html|meshcat\.html|favicon\.ico|download|cas-v1/[0-9a-f]{64})"
_CHUNK = 65_536
_PONG = 0x8A  # First byte of a WebSocket's answer to a ping (RFC 6455)


def open_meshcat(
    site: Site,
    *,
    page: str = "world",
    title: str = "World",
    close: Callable[[], None] | None = None,
) -> Meshcat:
    """Return a Meshcat whose page is on a site; its `web_url` is the page's address there.

    Drake's server checks neither Host nor Origin, and a message that is not whole ends it, and the
    run with it. It therefore listens where no page finds it: at a random address of this machine's
    own loop, 127.x.y.z, and a random port. The site passes everything on from it, and nothing to
    it: what a page says, such as the state of a gamepad, is dropped, so Meshcat's own sliders and
    buttons have no effect. A page that reads nothing for `PATIENCE` is disconnected.

    The hidden server itself still answers everybody. A page of another origin would have to guess
    24 bits of its address and about 15 bits of its port, at some hundreds of attempts per second.
    If the system has no loop address but 127.0.0.1, as macOS, only the port is hidden, and a
    patient page can find it. Programs on this machine can list open ports in any case.

    The site keeps the Meshcat until it is closed, or leaves that to a caller who is told to
    ``close``.
    """
    logging.getLogger("drake").addFilter(_is_news)
    for host in (_random_loop_address(), "127.0.0.1"):
        parameters = MeshcatParams(
            host=host,
            port=0,
            web_url_pattern=site.address(page),
            show_stats_plot=False,
        )
        with suppress(RuntimeError):
            meshcat = Meshcat(parameters)
            break
    else:
        raise OSError("no port of this machine's loop is free for Meshcat")
    server = host, meshcat.port()
    handlers = [(_FILES, MeshcatPage, {"server": server})]
    site.add(page, title, handlers, keep=meshcat if close is None else None, close=close)
    return meshcat


def _is_news(record: logging.LogRecord) -> bool:
    """Return False for Drake's log records that tell a user nothing new.

    A slow page asks for pictures that newer ones have replaced, and gets these next. The page's
    address is told by whoever opens it.
    """
    text = record.getMessage()
    return "Unknown CAS key" not in text and "listening for connections" not in text


def _random_loop_address() -> str:
    last = [secrets.randbelow(256), secrets.randbelow(256), 1 + secrets.randbelow(254)]
    return ".".join(map(str, [127, *last]))


class _Numbers(Resolver):
    """Takes addresses in numbers as they are, without the threads that a program's end forbids."""

    async def resolve(
        self, host: str, port: int, family: int = socket.AF_UNSPEC
    ) -> list[tuple[int, Any]]:
        return [(socket.AF_INET, (host, port))]


class MeshcatPage(Guarded, WebSocketHandler):
    """Passes requests of one page on to Meshcat's server, and the server's messages to the page.

    What the server sends is passed on unread, and what the page sends is dropped. A page costs
    about 1 % of a core.
    """

    @property
    def needs_token(self) -> bool:  # type: ignore[override]
        """False for a picture, whose name is its hash: who can name it knows it.

        A foreign frame, such as a notebook's, has the token in its address only.
        """
        return not self.path_args[0].startswith("cas-v1/")

    def initialize(self, server: tuple[str, int]) -> None:
        """Keep the address and the port of Meshcat's server."""
        self._server = server
        self._upstream: IOStream | None = None

    def check_origin(self, origin: str) -> bool:
        """Return True, because the site's rule has checked the origin."""
        return True

    async def get(self, path: str) -> None:
        """Open a WebSocket, or answer with a file."""
        if self.request.headers.get("Upgrade", "").lower() == "websocket":
            await super().get(path)
            return
        host, port = self._server
        answer = await AsyncHTTPClient(resolver=_Numbers()).fetch(
            f"http://{host}:{port}/{path}", raise_error=False, request_timeout=60
        )
        self.set_status(answer.code, answer.reason)
        named = guess_type(answer.headers.get("Meshcat-Cas-Filename", ""))[0]
        kind = answer.headers.get("Content-Type", named or "application/octet-stream")
        self.set_header("Content-Type", kind)
        if "javascript" in kind:  # it is Drake's, and large
            self.set_header("Cache-Control", answer.headers.get("Cache-Control", "no-store"))
        await self.finish(answer.body)

    async def open(self, path: str) -> None:
        """Open a WebSocket to Meshcat's server."""
        page: IOStream = self.ws_connection.stream
        try:
            self._upstream = await TCPClient(_Numbers()).connect(*self._server)
            key = base64.b64encode(secrets.token_bytes(16)).decode()
            await self._upstream.write(
                "GET / HTTP/1.1\r\nHost: meshcat\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
            )
            await self._upstream.read_until(b"\r\n\r\n", max_bytes=_CHUNK)
        except OSError:
            self.close(1011, "Meshcat has ended")
            return
        self._relay = asyncio.create_task(self._pass_on(self._upstream, page))

    def on_message(self, message: str | bytes) -> None:
        """Drop what a page says, because nobody listens to it."""

    def on_pong(self, data: bytes) -> None:
        """Tell the server that the page is alive: it disconnects those that do not answer."""
        self._answer = asyncio.create_task(self._answer_ping(data))

    def on_close(self) -> None:
        """Close the connection to the server."""
        if self._upstream is not None:
            self._upstream.close()

    async def _answer_ping(self, data: bytes) -> None:
        """Send the answer to a ping, at most 125 bytes and masked by zero, to the server."""
        if self._upstream is not None:
            with suppress(StreamClosedError):
                await self._upstream.write(bytes([_PONG, 0x80 | len(data)]) + bytes(4) + data)

    async def _pass_on(self, upstream: IOStream, page: IOStream) -> None:
        """Pass bytes from the server on to the page, until one of them closes or does not read."""
        with suppress(StreamClosedError):
            while True:
                written = page.write(await upstream.read_bytes(_CHUNK, partial=True))
                await asyncio.wait({written}, timeout=PATIENCE)
                if not written.done():
                    break
        page.close()
        upstream.close()
