"""Server of all pages of a run, on a thread of its own."""

import asyncio
import atexit
import errno
import html
import secrets
import socket
import threading
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hmac import compare_digest
from ipaddress import ip_address
from socket import gethostname
from typing import Any, Self, TypeVar
from urllib.parse import urlsplit

from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.routing import Router
from tornado.web import Application, HTTPError, RequestHandler, StaticFileHandler

from sonoservo.systems.signals.requirements import require

_EVERYWHERE = ("", "*", "0.0.0.0", "::")  # Names of all addresses of this machine
_TOKEN = secrets.token_urlsafe(24)


@dataclass(frozen=True)
class Access:
    """Rule for requests to the pages of a run.

    A browser sends the requests of any open page to any server on this machine, and the name in
    such a page's address may be made to stand for this machine afterwards (DNS rebinding). A
    request is therefore answered only if

    - its Host header names this server, which is not so after DNS rebinding,
    - its Origin header, if it has one, names the same server. A WebSocket must have one, because
      browsers do not keep foreign pages from opening WebSockets;
    - it carries the token, which is drawn anew for each program.

    The Host's port is not checked, so that the pages can be reached through a tunnel.

    Parameters
    ----------
    host
        Name or address at which the server listens; ``*`` stands for all addresses of this machine.
    token
        Secret that every request must carry; by default the one of this program.

    Notes
    -----
    The rule guards against pages in a browser. It does not guard against other programs that run
    under the same user, nor against anyone who can read the traffic to a `host` that is not this
    machine: it is not encrypted. Browsers send cookies to every port of a host, so a user who opens
    another server's page under the same host name shows the token to that server.
    """

    host: str = "localhost"
    token: str = field(default=_TOKEN, repr=False)

    @property
    def listens_everywhere(self) -> bool:
        """True if the server listens at all addresses of this machine."""
        return self.host in _EVERYWHERE

    @property
    def public_name(self) -> str:
        """Host name for the addresses that are given to the user, in brackets if IPv6."""
        name = gethostname() if self.listens_everywhere else self.host
        return f"[{name}]" if ":" in name else name

    def refusal(
        self, host: str | None, origin: str | None, tokens: Iterable[str], *, websocket: bool
    ) -> str | None:
        """Return why a request with such headers and tokens is refused; None if it is not."""
        if host is None or not self._is_own(host):
            return "Its address does not name this server."
        foreign = origin is not None and origin.lower() != f"http://{host.lower()}"
        if foreign or (websocket and origin is None):
            return "It was sent by another page."
        wanted = self.token.encode()
        if not any(compare_digest(token.encode(), wanted) for token in tokens):
            return "It lacks the token of this run."
        return None

    def _is_own(self, host: str) -> bool:
        """Return True if a Host header names this server."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
            urlsplit(f"//{host}").port  # noqa: B018 - raises a ValueError if there is no such port
        except ValueError:
            return False
        if name in ("localhost", "127.0.0.1", "::1"):
            return True
        if not self.listens_everywhere:
            return name == self.host.lower().strip("[]")
        # DNS rebinding needs a name: an address in numbers stands for itself.
        return name == gethostname().lower() or _is_address(name)


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True


T = TypeVar("T")

PORT = 7000
"""Port that a site tries first."""

MAX_MESSAGE = 65_536
"""Maximum size in bytes of a page's message; real ones stay below a kilobyte."""

_PORTS = 100  # Number of successive ports that are tried
_FAREWELL = 0.05  # Time in s for telling open pages that the server stops
_REFUSED = """\
<!DOCTYPE html><meta charset="utf-8"><title>Refused</title>
<style>body {{ font: 16px sans-serif; max-width: 40em; margin: 15vh auto; }}</style>
<h1>This page is private</h1>
<p>It can steer a robot, so the request was refused. {reason}</p>
<p>Open the whole address that the program printed in its terminal, up to the end of
<code>?token=...</code>. Each start of the program has a new one.</p>
"""


class Site:
    """Serves all pages of a run under one address, and only to those who know its token.

    A browser that has opened a page's `address` keeps the token in it as a cookie, which it sends
    to this site only (SameSite=Strict) and shows to no script (HttpOnly). `Access` is the rule for
    every request; the list of the pages is at the site's root. The host may be ``*``, for all
    addresses of this machine, and a port in use gives way to the next free one. The site serves on
    a thread of its own, and ends with the process. OSError if the host is no address of this
    machine, or no port is free.
    """

    def __init__(self, *, host: str = "localhost", port: int = PORT) -> None:
        require(0 < port <= 65535, "port", port, "1 to 65535")
        require(bool(host), "host", host, "a name or an address, or * for all")
        self.access = Access(host)
        sockets = _listen(host, port)
        self.port: int = sockets[0].getsockname()[1]
        self._titles: dict[str, str] = {}
        self._kept: list[object] = []
        self._loop = asyncio.new_event_loop()
        self.cookie = f"sonoservo_{self.port}"
        self._application = Application(
            [("/", _Index, {"titles": self._titles}), (r"/favicon\.ico", _NoIcon)],
            default_handler_class=_Unknown,
            default_handler_args={},
            access=self.access,
            cookie=self.cookie,
            log_function=lambda handler: None,
            websocket_max_message_size=MAX_MESSAGE,
        )
        self._closing: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._serve, args=(sockets,), daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread that draws must not outlive the interpreter

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def address(self, page: str = "") -> str:
        """Return the address at which a user opens a page, by its name; it holds the token."""
        path = f"{page}/" if page else ""
        token = self.access.token
        return f"http://{self.access.public_name}:{self.port}/{path}?token={token}"

    def add(
        self,
        page: str,
        title: str,
        handlers: Sequence[tuple[str, type["Guarded"], dict[str, Any]]],
        *,
        rest: Router | None = None,
        keep: object = None,
        close: Callable[[], None] | None = None,
    ) -> None:
        """Add a page by its name in the address and its title.

        Each handler has a path below the page's, a class and arguments; a `rest` of other paths
        must guard itself. `keep` is an object that lives until the site is closed, and `close` is
        called on the site's thread before it stops. ValueError if the site has such a page.
        """
        require(page not in self._titles, "page", page, "a name that the site does not have yet")

        def do() -> None:
            self._titles[page] = title
            below: list[Any] = [(f"/{page}/{path}", *handler) for path, *handler in handlers]
            if rest is not None:
                below.append((f"/{page}/.*", rest))
            self._application.add_handlers(".*", below)
            if close is not None:
                self._closing.append(close)

        self.ask(do)
        self._kept.append(keep)

    def call(self, function: Callable[[], None]) -> None:
        """Call a function on the site's thread soon; return at once, even if it is closed."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function)

    def ask(self, function: Callable[[], T]) -> T:
        """Call a function on the site's thread, and return its result."""
        if threading.current_thread() is self._thread:
            return function()

        async def answer() -> T:
            return function()

        return asyncio.run_coroutine_threadsafe(answer(), self._loop).result()

    def close(self) -> None:
        """Stop serving."""
        atexit.unregister(self.close)
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()
        self._kept.clear()

    def _serve(self, sockets: list[socket.socket]) -> None:
        asyncio.set_event_loop(self._loop)
        server = HTTPServer(self._application, max_body_size=4096, idle_connection_timeout=60)
        server.add_sockets(sockets)
        try:
            self._loop.run_forever()
        finally:
            server.stop()
            for close in self._closing:
                close()
            self._loop.run_until_complete(asyncio.sleep(_FAREWELL))
            self._loop.run_until_complete(server.close_all_connections())
            left = asyncio.all_tasks(self._loop)
            for task in left:
                task.cancel()
            self._loop.run_until_complete(asyncio.gather(*left, return_exceptions=True))
            self._loop.close()


class Guarded(RequestHandler):
    """Request handler that answers only what the site's rule allows."""

    needs_token = True

    def prepare(self) -> None:
        """Refuse the request, or remember the token in the browser."""
        access: Access = self.settings["access"]
        cookie: str = self.settings["cookie"]
        shown = self.get_query_argument("token", "")
        known = self.get_cookie(cookie, "") or ""
        reason = access.refusal(
            self.request.headers.get("Host"),
            self.request.headers.get("Origin"),
            (shown, known) if self.needs_token else (access.token,),
            websocket=self.request.headers.get("Upgrade", "").lower() == "websocket",
        )
        if reason is not None:
            self.set_status(403)
            self.finish(_REFUSED.format(reason=html.escape(reason)))
        elif self.needs_token and known != access.token:
            self.set_cookie(cookie, access.token, httponly=True, samesite="Strict")
        elif self.needs_token and shown != access.token:
            # Another site's frame would let it steal clicks; a notebook's frame shows the token.
            self.set_header("Content-Security-Policy", "frame-ancestors 'self'")

    def set_default_headers(self) -> None:
        """Keep what is served away from other pages, and from disks."""
        self.set_header("Cache-Control", "no-store")
        self.set_header("Cross-Origin-Resource-Policy", "same-origin")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Content-Type-Options", "nosniff")


class Document(Guarded):
    """Serves one text."""

    def initialize(self, text: str) -> None:
        """Keep the text."""
        self._text = text

    def get(self) -> None:
        """Answer with the text."""
        self.finish(self._text)


class Files(Guarded, StaticFileHandler):
    """Serves the files of a folder."""


class _Index(Guarded):
    """Serves the list of the pages."""

    def initialize(self, titles: dict[str, str]) -> None:
        self._titles = titles

    def get(self) -> None:
        rows = "".join(
            f'<li><a href="{page}/">{html.escape(title)}</a>'
            for page, title in self._titles.items()
        )
        self.finish(f'<!DOCTYPE html><meta charset="utf-8"><title>sonoservo</title><ul>{rows}</ul>')


class _NoIcon(Guarded):
    """Answers a browser that asks for the icon of a page without one, which a 404 would warn of."""

    def get(self) -> None:
        self.set_status(204)


class _Unknown(Guarded):
    """Answers for a path that no page has, but only to those who may ask."""

    def prepare(self) -> None:
        super().prepare()
        if not self._finished:
            raise HTTPError(404)


def _listen(host: str, port: int) -> list[socket.socket]:
    """Return sockets that listen on the first free port."""
    last = min(port + _PORTS - 1, 65535)
    for number in range(port, last + 1):
        try:
            return bind_sockets(number, "" if host == "*" else host)
        except socket.gaierror as error:
            raise OSError(f"host: {host!r} is no name or address of this machine") from error
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL:
                raise OSError(f"host: {host!r} is no name or address of this machine") from error
            if error.errno != errno.EADDRINUSE:
                raise
    raise OSError(f"port: none of {port} to {last} is free on {host!r}")
