"""Server of a meshcat scene for any number of web pages, on a thread of its own."""

import asyncio
import atexit
import base64
import errno
import socket
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeVar

import meshcat
import umsgpack
from tornado.httpserver import HTTPServer
from tornado.netutil import bind_sockets
from tornado.web import Application, RequestHandler, StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from sonoservo.systems.signals.requirements import require

T = TypeVar("T")

_PORTS = 100
"""Number of successive ports that are tried."""

_FAREWELL = 0.05
"""Time in s for telling open pages that the server stops."""

_VIEWER = "main.min.js"
_HANDLE = """
  function handle(batch) {
    const view = new DataView(batch);
    for (let start = 0; start < batch.byteLength;) {
      const end = start + 4 + view.getUint32(start);
      viewer.handle_command_bytearray(new Uint8Array(batch.slice(start + 4, end)));
      document.getElementById("waiting").style.display = "none";
      start = end;
    }
  }
"""

_CONNECT = """
  function connect() {
    viewer.connect(`ws://${location.host}/commands`);
    const connection = viewer.connection;
    connection.onmessage = (message) => {
      handle(message.data);
      requestAnimationFrame(() => {
        if (connection.readyState === WebSocket.OPEN) connection.send("drawn");
      });
    };
    const show = (shown) => () => {
      document.getElementById("stopped").style.display = shown ? "block" : "none";
    };
    connection.onopen = show(false);
    connection.onclose = () => { show(true)(); setTimeout(connect, 1000); };
  }
  connect();
"""

_DRAW = """
  handle(Uint8Array.from(atob("BATCH"), (c) => c.charCodeAt(0)).buffer);
"""


class PageServer:
    """Shows a meshcat scene in web pages; replaces the `window` of a `Visualizer`.

    The package's own server listens on every network interface and runs as a separate process,
    which can be left behind. It makes the sender wait for each command and, for a slow page, queues
    everything it was ever sent. This one keeps only the newest command for each object and
    property. A page that opens, or that has drawn everything it was sent, receives only these.

    The server ends with the process.

    Parameters
    ----------
    page
        HTML of the page. ``<!-- VIEWER -->`` in it becomes meshcat's script. ``/* FEED */`` becomes
        the script that connects the variable ``viewer``, a ``MeshCat.Viewer``, to this server. The
        element ``waiting`` is shown until the first command arrives, and ``stopped`` while there is
        no server.
    host
        Name or address to listen on.
    port
        Port to listen on, or the next free one if it is in use.
    asked
        Function called on the server's thread when a page has opened, or has drawn everything it
        was sent.

    Raises
    ------
    ValueError
        If the port is not between 1 and 65535.
    OSError
        If the host is not an address of this machine, or no port is free.
    """

    def __init__(
        self, *, page: str, host: str = "localhost", port: int, asked: Callable[[], None]
    ) -> None:
        require(0 < port <= 65535, "port", port, "1 to 65535")
        self._page, self._asked = page, asked
        self._scene: dict[tuple[str, str, str], bytes] = {}
        self._pages: set[_Page] = set()
        sockets = _listen(host, port)
        self._port = sockets[0].getsockname()[1]
        self._host = host
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, args=(sockets,), daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread that draws must not outlive the interpreter

    @property
    def web_url(self) -> str:
        """Address of the page."""
        anywhere = self._host in ("", "0.0.0.0", "::", "*")
        host = socket.gethostname() if anywhere else self._host
        return f"http://{f'[{host}]' if ':' in host else host}:{self._port}/"

    @property
    def wanted(self) -> bool:
        """True if an open page has drawn everything it was sent."""
        return any(page.waits for page in self._pages)

    def call(self, function: Callable[[], None]) -> None:
        """Call a function on the server's thread soon; return at once, even if it is closed."""
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(function)

    def ask(self, function: Callable[[], T]) -> T:
        """Call a function on the server's thread, and return its result."""

        async def answer() -> T:
            return function()

        return asyncio.run_coroutine_threadsafe(answer(), self._loop).result()

    def send(self, command: Any) -> None:
        """Send a meshcat command to the pages. Call it on the server's thread only."""
        data = command.lower()
        key = data["type"], data["path"], data.get("property", "")
        self._scene[key] = umsgpack.packb(data)
        for page in self._pages:
            page.send(key)

    def html(self) -> str:
        """Return the current page as one HTML document that needs no server."""
        script = _asset(_VIEWER).read_text().replace("</script", "<\\/script")
        batch = base64.b64encode(_batch(self._scene.values())).decode()
        return self._filled(f"<script>{script}</script>", _DRAW.replace("BATCH", batch))

    def close(self) -> None:
        """Stop serving."""
        atexit.unregister(self.close)
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join()

    def _filled(self, viewer: str, feed: str) -> str:
        return self._page.replace("<!-- VIEWER -->", viewer).replace("/* FEED */", _HANDLE + feed)

    def _serve(self, sockets: list[socket.socket]) -> None:
        asyncio.set_event_loop(self._loop)
        live = self._filled(f'<script src="{_VIEWER}"></script>', _CONNECT)
        server = HTTPServer(
            Application(
                [
                    ("/", _Document, {"text": live}),
                    (f"/({_VIEWER})", StaticFileHandler, {"path": str(_asset(""))}),
                    ("/commands", _Page, {"scene": self._scene, "pages": self._pages,
                                          "asked": self._asked}),
                ]
            )
        )  # fmt: skip
        server.add_sockets(sockets)
        try:
            self._loop.run_forever()
        finally:
            server.stop()
            for page in tuple(self._pages):
                page.close()
            self._loop.run_until_complete(asyncio.sleep(_FAREWELL))
            self._loop.close()


class _Document(RequestHandler):
    def initialize(self, text: str) -> None:
        self._text = text

    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.finish(self._text)


class _Page(WebSocketHandler):
    """An open page and the commands it has yet to receive."""

    def initialize(
        self,
        scene: dict[tuple[str, str, str], bytes],
        pages: set["_Page"],
        asked: Callable[[], None],
    ) -> None:
        self._scene, self._pages, self._asked = scene, pages, asked
        self._due: dict[tuple[str, str, str], None] = {}
        self.waits = False  # True once it has drawn everything it was sent

    async def open(self) -> None:
        self._due = dict.fromkeys(self._scene)
        self._pages.add(self)
        await self._go_on()

    def on_close(self) -> None:
        self._pages.discard(self)

    async def on_message(self, message: str | bytes) -> None:
        await self._go_on()

    def send(self, key: tuple[str, str, str]) -> None:
        self._due[key] = None
        if self.waits:
            self.waits = False
            # Sent later, together with everything else that is drawn now.
            self._sending = asyncio.create_task(self._send_due())

    async def _go_on(self) -> None:
        """Send the new commands to a page that has drawn everything it was sent."""
        self.waits = True
        self._asked()
        await self._send_due()

    async def _send_due(self) -> None:
        """Send all due commands together; the page answers when it has drawn them."""
        due, self._due = self._due, {}
        if not due:
            return
        self.waits = False
        try:
            await self.write_message(_batch(self._scene[key] for key in due), binary=True)
        except WebSocketClosedError:
            self._pages.discard(self)


def _batch(commands: Iterable[bytes]) -> bytes:
    """Return commands as one message, each preceded by its length in four bytes."""
    return b"".join(len(each).to_bytes(4) + each for each in commands)


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


def _asset(name: str) -> Path:
    return Path(meshcat.viewer_assets_path()) / "dist" / name


def read_page(name: str) -> str:
    """Return the text of a page in this module's folder."""
    return (files("sonoservo.systems.display.monitor") / name).read_text()
