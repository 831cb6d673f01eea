"""What a page says to its Meshcat, without a page, and what no page would say."""

import base64
import os
import socket

import umsgpack


class MeshcatSocket:
    """A websocket to a Meshcat on this machine."""

    def __init__(self, meshcat):
        self._socket = socket.create_connection(("localhost", meshcat.port()), timeout=10)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: localhost:{meshcat.port()}\r\nUpgrade: websocket\r\n"
            f"Connection: Upgrade\r\nSec-WebSocket-Key: {key}\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        assert self._socket.recv(12) == b"HTTP/1.1 101"

    def say(self, **message):
        """Send a message of Meshcat's, as its page does."""
        self.send(umsgpack.packb(message))

    def slide(self, name, value):
        self.say(type="slider", name=name, value=value)

    def click(self, name):
        self.say(type="button", name=name)

    def send(self, data):
        """Send bytes in one frame (RFC 6455), masked by zero."""
        assert len(data) < 2**16
        length = len(data)
        head = bytes([0x82, 0x80 | length]) if length < 126 else b"\x82\xfe" + length.to_bytes(2)
        self._socket.sendall(head + bytes(4) + data)

    def send_raw(self, data):
        """Send bytes that are no frame at all."""
        self._socket.sendall(data)

    def half_close(self):
        self._socket.shutdown(socket.SHUT_WR)

    def close(self):
        self._socket.close()
