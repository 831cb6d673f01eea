import gc
import socket
import subprocess
import sys
import threading
import tracemalloc
import urllib.request
from contextlib import closing
from urllib.parse import urlsplit

import numpy as np
import pytest
from meshcat.commands import SetProperty
from meshcat.path import Path
from page_clients.page_socket import CLOSE, open_socket, send_frame

from sonoservo.systems.display.monitor.drawing import MonitorScreen
from sonoservo.systems.display.monitor.monitor import Monitor
from sonoservo.systems.display.monitor.scene_page import ScenePage
from sonoservo.systems.display.pages.site import Site

PAGE = "<!-- VIEWER --><script>/* FEED */</script>"


@pytest.fixture
def monitor():
    with closing(Monitor()) as monitor:
        yield monitor


@pytest.fixture
def site():
    with Site() as site:
        yield site


@pytest.fixture
def scene(site):
    return ScenePage(site, name="scene", title="Scene", page=PAGE, asked=lambda: None)


def zeros(p_P):
    return np.zeros(p_P.shape[:-1])


def put(site, scene, name, value):
    command = SetProperty("name", value, Path(("meshcat", name)))
    site.ask(lambda: scene.send(command))


def test_the_page_asks_for_nothing_else(monitor):
    text = urllib.request.urlopen(monitor.web_url).read().decode()
    assert text.count("src=") == 1
    script = urllib.request.urlopen(monitor.web_url.replace("?", "main.min.js?")).read()
    assert b"MeshCat" in script
    assert f'src="{monitor.web_url}"' in monitor._repr_html_()


def test_nothing_is_drawn_for_nobody(monitor, make_volume):
    for time in range(5):
        monitor.show(make_volume(zeros, time=time))
    with closing(Monitor()) as other:
        empty = len(other.html())
    assert len(monitor._site.ask(monitor._page.html)) == empty
    assert len(monitor.html()) > empty + 10_000  # asked for, it is


def test_the_document_holds_what_the_newest_volume_shows(monitor, make_volume):
    monitor.show(make_volume(zeros))
    before = monitor.html()
    assert before == monitor.html()
    monitor.show(make_volume(lambda p_P: 100 + 1000 * p_P[..., 0]))
    assert before != monitor.html()


def test_no_garbage_is_collected_on_the_thread_that_draws(monitor, make_volume, monkeypatch):
    collects = []
    monkeypatch.setattr(MonitorScreen, "draw", lambda *_: collects.append(gc.isenabled()))
    monitor.show(make_volume(zeros))
    monitor.html()
    assert collects == [False]
    assert gc.isenabled()


def test_what_a_slow_page_did_not_read_is_left_out(site, scene):
    """200 pictures of 1 MB for one that reads none of them: at the most a few are kept."""
    slow = open_socket(site.address("scene"), "commands")
    while not scene.wanted:
        site.ask(lambda: None)
    tracemalloc.start()
    for number in range(200):
        put(site, scene, "picture", str(number) * 500_000)
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept < 20e6
    slow.close()
    put(site, scene, "picture", "the end")  # nobody is hurt


def test_a_page_that_opens_gets_the_newest_of_each_object_alone(site, scene):
    for number in range(3):
        put(site, scene, "first", f"first {number}")
        put(site, scene, "second", f"second {number}")
    with open_socket(site.address("scene"), "commands") as page:
        received = b""
        while b"second 2" not in received:
            received += page.recv(4096)
    assert [received.count(f"first {n}".encode()) for n in range(3)] == [0, 0, 1]
    assert received.count(b"second") == 2  # its path and its value


@pytest.mark.parametrize("message", [b"drawn?", b"\xff\xfe", b"", bytes(5000)])
def test_a_page_that_says_anything_else_is_disconnected(site, scene, message):
    with open_socket(site.address("scene"), "commands") as page:
        send_frame(page, message)
        assert page.recv(2)[0] == CLOSE
    with open_socket(site.address("scene"), "commands") as other:
        put(site, scene, "first", "first")
        assert b"first" in other.recv(4096)


def test_showing_goes_on_after_the_end(monitor, make_volume):
    volume = make_volume(zeros)
    monitor.close()
    monitor.close()
    monitor.show(volume)


def test_nothing_is_left_behind_by_a_process_that_ends():
    count = threading.active_count()
    monitor = Monitor()
    assert threading.active_count() == count + 1
    monitor.close()
    assert threading.active_count() == count
    program = (
        "from sonoservo.systems.display.monitor.monitor import Monitor; print(Monitor().web_url)"
    )
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], capture_output=True, text=True, timeout=60
    )
    assert (done.returncode, done.stderr) == (0, "")
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("localhost", urlsplit(done.stdout.strip()).port), timeout=5)
