"""Meshcat behind a site: what gets through, and what a page that misbehaves costs."""

import math
import os
import re
import socket
import time
from contextlib import closing
from urllib.parse import urlsplit
from urllib.request import urlopen

import pytest
import umsgpack
from page_clients.meshcat_socket import MeshcatSocket
from page_clients.page_socket import ask, open_socket, read_frame, read_until_closed, send_frame
from pydrake.math import RigidTransform

from sonoservo.systems.display.pages import meshcat_page
from sonoservo.systems.display.pages.meshcat_page import open_meshcat
from sonoservo.systems.display.pages.site import Site

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
    """A page that behaves; it is served at the end as at the start."""
    page = MeshcatSocket(meshcat)
    yield page
    page.slide("depth", 20)
    wait_for(lambda: meshcat.GetSliderValue("depth") == 20)
    page.slide("depth", 5)
    wait_for(lambda: meshcat.GetSliderValue("depth") == 5)
    page.close()
    wait_for(lambda: meshcat.GetNumActiveConnections() == 0)


def wait_for(condition):
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def connection(meshcat):
    return closing(open_socket(meshcat.web_url()))


def test_the_page_is_drakes_and_finds_its_files(meshcat):
    url = meshcat.web_url()
    text = urlopen(url).read().decode()
    assert "Drake MeshCat" in text
    (source,) = re.findall('src="([^"]*)"', text)
    script = urlopen(url.replace("?", f"{source}?"))
    assert "javascript" in script.headers["Content-Type"]
    assert len(script.read()) > 1e6


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
        assert b"Drake" in urlopen(meshcat.web_url()).read()


def test_a_page_is_told_everything_and_steers(meshcat, page):
    meshcat.SetTransform("box", RigidTransform([1, 2, 3]))
    with connection(meshcat) as other:
        messages = [umsgpack.unpackb(read_frame(other)[1]) for _ in range(4)]
        assert {"/drake/box", "depth", "pause"} <= {
            each.get("path", each.get("name")) for each in messages
        }
        clicks = meshcat.GetButtonClicks("pause")
        page.click("pause")
        page.slide("depth", 42)
        wait_for(lambda: meshcat.GetSliderValue("depth") == 42)
        assert meshcat.GetButtonClicks("pause") == clicks + 1
        told = umsgpack.unpackb(read_frame(other)[1])
        assert (told["name"], told["value"]) == ("depth", 42)


def test_pages_without_the_token_or_of_another_origin_do_not_reach_it(meshcat):
    bare = meshcat.web_url().partition("?")[0]
    count = meshcat.GetNumActiveConnections()
    assert "403" in ask(bare)[0]
    assert "403" in ask(meshcat.web_url(), Origin="http://evil.example")[0]
    assert "403" in ask(meshcat.web_url(), Host="evil.example")[0]
    assert meshcat.GetNumActiveConnections() == count


MALFORMED = {
    "no MessagePack": b"\xff\xfe\xfd" + bytes(100),
    "half a message": umsgpack.packb({"type": "button", "name": "pause"})[:-2],
    "nothing": b"",
    "not a number": umsgpack.packb({"type": "slider", "name": "depth", "value": math.nan}),
    "a camera that is no rotation": umsgpack.packb(
        {"type": "camera_pose", "camera_pose": [1.0] * 16, "is_perspective": True}
    ),
    "of no known type": umsgpack.packb({"type": "delete", "path": "/"}),
    "ten megabytes": bytes(10**7),
}


@pytest.mark.parametrize("data", MALFORMED.values(), ids=MALFORMED)
def test_a_malformed_message_costs_its_page_the_connection(meshcat, page, data):
    with connection(meshcat) as bad:
        try:
            send_frame(bad, data)
        except ConnectionError:
            return  # it was not even read to its end
        read_until_closed(bad)
    wait_for(lambda: meshcat.GetNumActiveConnections() == 1)


def test_torn_frames_cost_their_page_the_connection(meshcat, page):
    whole = umsgpack.packb({"type": "button", "name": "pause"})
    for data in (
        bytes([0x82, 0x80 | len(whole)]) + bytes(4) + whole[:5],  # ends in the middle
        bytes([0x82, len(whole)]) + whole,  # not masked
        bytes([0xF2, 0x80 | len(whole)]) + bytes(4) + whole,  # of no known kind
        bytes([0x80, 0x80 | len(whole)]) + bytes(4) + whole,  # goes on with nothing
        bytes([0x82, 0xFF]) + b"\xff" * 8,  # longer than any memory
        os.urandom(5000),
    ):
        with connection(meshcat) as bad:
            bad.sendall(data)
            bad.shutdown(socket.SHUT_WR)
            read_until_closed(bad)
    wait_for(lambda: meshcat.GetNumActiveConnections() == 1)


def test_a_page_that_reads_nothing_is_disconnected(meshcat, page):
    """Drake would keep everything for it, without a limit."""
    with connection(meshcat):
        wait_for(lambda: meshcat.GetNumActiveConnections() == 2)
        page.read_in_background()
        for number in range(60):
            meshcat.SetProperty("box", "note", [float(number)] * 100_000)
        wait_for(lambda: meshcat.GetNumActiveConnections() == 1)


def test_a_page_outlives_its_meshcat_and_says_so():
    with Site() as site:
        open_meshcat(site, page="lost")
        url = site.address("lost")
        site._kept.clear()
        with closing(open_socket(url)) as page:
            assert read_until_closed(page) == []
