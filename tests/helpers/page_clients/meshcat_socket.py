"""What a page says to its Meshcat, without a page, and what no page would say."""

import socket
import threading
from contextlib import suppress

import umsgpack

from page_clients.page_socket import open_socket, send_frame


class MeshcatSocket:
    """A websocket to a Meshcat on this machine."""

    def __init__(self, meshcat):
        self._socket = open_socket(meshcat.web_url())

    def say(self, **message):
        """Send a message of Meshcat's, as its page does."""
        self.send(umsgpack.packb(message))

    def slide(self, name, value):
        self.say(type="slider", name=name, value=value)

    def click(self, name):
        self.say(type="button", name=name)

    def send(self, data):
        """Send bytes in one frame."""
        send_frame(self._socket, data)

    def send_raw(self, data):
        """Send bytes that are no frame at all."""
        self._socket.sendall(data)

    def read_in_background(self):
        """Read what comes from now on, and forget it."""

        def read():
            with suppress(OSError):
                while self._socket.recv(2**20):
                    pass

        self._socket.settimeout(None)
        threading.Thread(target=read, daemon=True).start()

    def half_close(self):
        self._socket.shutdown(socket.SHUT_WR)

    def close(self):
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)  # also ends what reads in the background
        self._socket.close()
