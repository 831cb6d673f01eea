"""A meshcat scene as a page of a site, for any number of viewers."""

import asyncio
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import meshcat
import umsgpack
from tornado.web import StaticFileHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from sonoservo.systems.display.pages.site import Document, Guarded, Site

_VIEWER = "main.min.js"
_CONNECT = """
  function handle(batch) {
    const view = new DataView(batch);
    for (let start = 0; start < batch.byteLength;) {
      const end = start + 4 + view.getUint32(start);
      viewer.handle_command_bytearray(new Uint8Array(batch.slice(start + 4, end)));
      start = end;
    }
  }

  function connect() {
    viewer.connect(`ws://${location.host}${location.pathname}commands${location.search}`);
    const connection = viewer.connection;
    connection.onmessage = (message) => {
      handle(message.data);
      requestAnimationFrame(() => {
        if (connection.readyState === WebSocket.OPEN) connection.send("drawn");
      });
    };
  }
  connect();
"""


class ScenePage:
    """Shows a meshcat scene as a page of a site, in place of a `Visualizer`'s window.

    The package's own server listens on every interface and queues all that a slow page was ever
    sent; this one keeps the newest command for each object and property, and sends these to a page
    that has drawn what it had. `asked` is called on the site's thread when a page is ready.
    """

    def __init__(
        self, site: Site, *, name: str, title: str, page: str, asked: Callable[[], None]
    ) -> None:
        self._scene: dict[tuple[str, str, str], bytes] = {}
        self._viewers: set[_Viewer] = set()
        viewer = f'<script src="{_VIEWER}"></script>'
        text = page.replace("<!-- VIEWER -->", viewer).replace("/* FEED */", _CONNECT)
        shared = {"scene": self._scene, "viewers": self._viewers, "asked": asked}
        site.add(
            name,
            title,
            [
                ("", Document, {"text": text}),
                (f"({_VIEWER})", _Library, {"path": str(_asset(""))}),
                ("commands", _Viewer, shared),
            ],
            close=self.disconnect,
        )

    @property
    def wanted(self) -> bool:
        """True if an open page has drawn everything it was sent."""
        return any(viewer.waits for viewer in self._viewers)

    def send(self, command: Any) -> None:
        """Send a meshcat command to the pages. Call it on the site's thread only."""
        data = command.lower()
        key = data["type"], data["path"], data.get("property", "")
        self._scene[key] = umsgpack.packb(data)
        for viewer in self._viewers:
            viewer.send(key)

    def disconnect(self) -> None:
        """Disconnect all pages. Call it on the site's thread only."""
        for viewer in tuple(self._viewers):
            viewer.close()


class _Library(Guarded, StaticFileHandler):
    """Serves meshcat's published script, which holds no secret.

    A framed page has the token in its address only.
    """

    needs_token = False


class _Viewer(Guarded, WebSocketHandler):
    """An open page and the commands it has yet to receive."""

    def initialize(
        self,
        scene: dict[tuple[str, str, str], bytes],
        viewers: set["_Viewer"],
        asked: Callable[[], None],
    ) -> None:
        self._scene, self._viewers, self._asked = scene, viewers, asked
        self._due: dict[tuple[str, str, str], None] = {}
        self.waits = False  # True once it has drawn everything it was sent

    def check_origin(self, origin: str) -> bool:
        return True  # the site's rule has checked it

    async def open(self) -> None:
        self._due = dict.fromkeys(self._scene)
        self._viewers.add(self)
        await self._go_on()

    def on_close(self) -> None:
        self._viewers.discard(self)

    async def on_message(self, message: str | bytes) -> None:
        if message == "drawn":
            await self._go_on()
        else:
            self.close(1008, "message refused")

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
            self._viewers.discard(self)


def _batch(commands: Iterable[bytes]) -> bytes:
    """Return commands as one message, each preceded by its length in four bytes."""
    return b"".join(len(each).to_bytes(4) + each for each in commands)


def _asset(name: str) -> Path:
    return Path(meshcat.viewer_assets_path()) / "dist" / name
