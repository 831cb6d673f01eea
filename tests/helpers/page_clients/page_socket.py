"""A page's connection to a site, without a browser, and what no browser would say."""

import base64
import os
import socket
from urllib.parse import urlsplit

BINARY, CLOSE = 0x82, 0x88
"""First bytes of frames (RFC 6455)."""


def ask(url, path="", **headers):
    """Lines of the answer to what a page's script opens, status first; see `connect`."""
    with connect(url, path, **headers) as connection:
        return connection.recv(65536).decode("latin-1").split("\r\n")


def connect(url, path="", **headers):
    """Ask for a WebSocket as a page's script does, and read nothing.

    The headers are the page's own unless given; None leaves one out.
    """
    place = urlsplit(url)
    key = base64.b64encode(os.urandom(16)).decode()
    wanted = {
        "Host": place.netloc,
        "Origin": f"http://{place.netloc}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Key": key,
        "Sec-WebSocket-Version": "13",
    } | headers
    lines = [f"{name}: {value}" for name, value in wanted.items() if value is not None]
    query = f"?{place.query}" if place.query else ""
    request = [f"GET {place.path or '/'}{path}{query} HTTP/1.1", *lines, "", ""]
    connection = socket.create_connection((place.hostname, place.port), timeout=10)
    connection.sendall("\r\n".join(request).encode())
    return connection


def open_socket(url, path="", **headers):
    """A WebSocket that a page's script opens."""
    connection = connect(url, path, **headers)
    answer = b""
    while not answer.endswith(b"\r\n\r\n"):
        answer += connection.recv(1)
    assert answer.startswith(b"HTTP/1.1 101")
    return connection


def send_frame(connection, data, kind=BINARY):
    """Send bytes in one frame, masked by zero."""
    length = len(data)
    if length < 126:
        head = bytes([kind, 0x80 | length])
    elif length < 2**16:
        head = bytes([kind, 0xFE]) + length.to_bytes(2)
    else:
        head = bytes([kind, 0xFF]) + length.to_bytes(8)
    connection.sendall(head + bytes(4) + data)


def read_frame(connection):
    """First byte and content of the next frame."""
    kind, length = _read(connection, 2)
    if length == 126:
        length = int.from_bytes(_read(connection, 2))
    elif length == 127:
        length = int.from_bytes(_read(connection, 8))
    return kind, _read(connection, length)


def read_until_closed(connection):
    """Contents of all frames until the connection is closed, by a frame or without one."""
    contents = []
    while True:
        try:
            kind, content = read_frame(connection)
        except ConnectionError:
            return contents
        if kind == CLOSE:
            return contents
        contents.append(content)


def _read(connection, count):
    data = b""
    while len(data) < count:
        part = connection.recv(count - len(data))
        if not part:
            raise ConnectionResetError
        data += part
    return data
