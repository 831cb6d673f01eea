"""Meshcat behind a site: what gets through, and what a page that misbehaves costs."""

import asyncio
import os
import re
import socket
import threading
import time
from contextlib import closing
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
import umsgpack
from live_items import wait_until
from page_clients.page_socket import (
    CLOSE,
    ask,
    open_socket,
    read_frame,
    read_until_closed,
    send_frame,
)

from sonoservo.systems.display import Site, open_meshcat
from sonoservo.systems.display.pages import meshcat_page

PATIENCE = 1.0


@pytest.fixture(scope="module")
def meshcat():
    with pytest.MonkeyPatch.context() as patch, Site() as site:
        patch.setattr(meshcat_page, "PATIENCE", PATIENCE)
        meshcat = open_meshcat(site)
        meshcat.AddSlider("depth", 0, 100, 1, 5)
        meshcat.AddButton("pause")
        yield meshcat


@pytest.fixture
def page(meshcat):
    """A page that behaves; it is told what happens at the end as at the start."""
    with connection(meshcat) as page:
        yield page
        note = time.monotonic()
        meshcat.SetProperty("box", "note", note)
        while umsgpack.unpackb(read_frame(page)[1]).get("value") != note:
            pass
    wait_until(lambda: meshcat.GetNumActiveConnections() == 0)


def connection(meshcat):
    return closing(open_socket(meshcat.web_url()))


def test_it_is_served_to_the_end_of_the_program(meshcat, monkeypatch):
    """When Python ends, its threads are gone before the site is closed."""

    def refused(*_):
        raise RuntimeError("cannot schedule new futures after shutdown")

    monkeypatch.setattr(asyncio.base_events.BaseEventLoop, "run_in_executor", refused)
    text = urlopen(meshcat.web_url()).read().decode()
    assert "Drake MeshCat" in text
    (source,) = re.findall('src="([^"]*)"', text)
    # A notebook's frame sends no cookie: what is named by its hash needs none, and no token.
    script = urlopen(meshcat.web_url().partition("?")[0] + source)
    assert "javascript" in script.headers["Content-Type"]
    assert len(script.read()) > 1e6
    with connection(meshcat):
        wait_until(lambda: meshcat.GetNumActiveConnections() == 1)
    wait_until(lambda: meshcat.GetNumActiveConnections() == 0)


def test_drakes_own_server_is_hidden(meshcat):
    announced = urlsplit(meshcat.web_url())
    assert announced.hostname == "localhost"
    assert announced.port != meshcat.port()
    for host in ("127.0.0.1", "::1"):
        with pytest.raises(OSError, match="refused|not available|assign"):
            socket.create_connection((host, meshcat.port()), timeout=5)


def test_where_there_is_one_loop_address_only_the_port_is_hidden(monkeypatch):
    monkeypatch.setattr(meshcat_page, "_random_loop_address", lambda: "192.0.2.7")
    with Site() as site:
        meshcat = open_meshcat(site)
        socket.create_connection(("127.0.0.1", meshcat.port()), timeout=5).close()
        url = meshcat.web_url()
        assert b"Drake" in urlopen(url).read()
        del meshcat
        site._kept.clear()
        with closing(open_socket(url)) as page:  # it outlives its Meshcat, and says so
            assert read_until_closed(page) == []


SAID = {
    "a slider": umsgpack.packb({"type": "slider", "name": "depth", "value": 42.0}),
    "a button": umsgpack.packb({"type": "button", "name": "pause"}),
    "a gamepad": umsgpack.packb({"type": "gamepad", "name": "", "gamepad": {}}),
    "no MessagePack": b"\xff\xfe\xfd" + bytes(100),
    "half a message": umsgpack.packb({"type": "button", "name": "pause"})[:-2],
    "nothing": b"",
    "a camera that is no rotation": umsgpack.packb(
        {"type": "camera_pose", "camera_pose": [1.0] * 16, "is_perspective": True}
    ),
    "nested lists": b"\x91" * 60_000,
}


def test_what_a_page_says_does_not_reach_drake(meshcat, page):
    """Most of it would end Drake's server, and this test with it."""
    clicks = meshcat.GetButtonClicks("pause")
    with connection(meshcat) as other:
        for data in SAID.values():
            send_frame(other, data)
        send_frame(other, b"a text", kind=0x81)
        send_frame(other, b"", kind=0x89)  # a ping
        send_frame(other, b"x" * 125, kind=0x8A)  # an answer to none
        send_frame(other, b"\x03\xe8", kind=CLOSE)
        read_until_closed(other)
    wait_until(lambda: meshcat.GetNumActiveConnections() == 1)
    assert meshcat.GetSliderValue("depth") == 5
    assert meshcat.GetButtonClicks("pause") == clicks


def test_pages_without_the_token_or_of_another_origin_do_not_reach_it(meshcat):
    bare = meshcat.web_url().partition("?")[0]
    count = meshcat.GetNumActiveConnections()
    assert "403" in ask(bare)[0]
    assert "403" in ask(meshcat.web_url(), Origin="http://evil.example")[0]
    assert "403" in ask(meshcat.web_url(), Host="evil.example")[0]
    assert meshcat.GetNumActiveConnections() == count


def test_torn_frames_cost_their_page_the_connection(meshcat, page):
    whole = umsgpack.packb({"type": "button", "name": "pause"})
    for data in (
        bytes([0x82, 0x80 | len(whole)]) + bytes(4) + whole[:5],  # ends in the middle
        bytes([0x82, len(whole)]) + whole,  # not masked
        bytes([0xF2, 0x80 | len(whole)]) + bytes(4) + whole,  # of no known kind
        bytes([0x80, 0x80 | len(whole)]) + bytes(4) + whole,  # goes on with nothing
        bytes([0x82, 0xFF]) + b"\xff" * 8,  # longer than any memory
        bytes([0x82, 0xFF]) + (10**7).to_bytes(8) + bytes(4),  # ten megabytes
        bytes([0x8A, 0xFE]) + (200).to_bytes(2) + bytes(204),  # too long an answer to a ping
        os.urandom(5000),
    ):
        with connection(meshcat) as bad:
            bad.sendall(data)
            bad.shutdown(socket.SHUT_WR)
            read_until_closed(bad)
    wait_until(lambda: meshcat.GetNumActiveConnections() == 1)


def test_a_page_that_reads_nothing_is_disconnected(meshcat):
    """Drake would keep everything for it, without a limit."""
    with connection(meshcat) as page, connection(meshcat):
        wait_until(lambda: meshcat.GetNumActiveConnections() == 2)
        reader = threading.Thread(target=read_until_closed, args=(page,))
        reader.start()
        for number in range(60):
            meshcat.SetProperty("box", "note", [float(number)] * 100_000)
        wait_until(lambda: meshcat.GetNumActiveConnections() == 1)
        page.shutdown(socket.SHUT_RDWR)
        reader.join()
    wait_until(lambda: meshcat.GetNumActiveConnections() == 0)
