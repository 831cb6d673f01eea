"""A page of a console without a browser: its connection, and a client of Bokeh's own."""

import re
from functools import partial
from unittest.mock import patch
from urllib.parse import urlsplit
from urllib.request import urlopen

from bokeh.client import pull_session
from tornado.httpclient import HTTPRequest

from page_clients.page_socket import open_socket


def session_token(url):
    """Token of the session that a page of a console was given."""
    return re.search(r'"token":"([^"]+)"', urlopen(url).read().decode())[1]


def open_console(url):
    """A WebSocket that a console's page opens, and that reads nothing."""
    return open_socket(url, "ws", **{"Sec-WebSocket-Protocol": f"bokeh, {session_token(url)}"})


def pull_console(url):
    """A session of Bokeh's client, which speaks as a page does, and has a page's Origin."""
    place = urlsplit(url)
    request = partial(HTTPRequest, headers={"Origin": f"http://{place.netloc}"})
    with patch("bokeh.client.connection.HTTPRequest", request):
        return pull_session(
            url=url.partition("?")[0].rstrip("/"),
            arguments={"token": place.query.partition("=")[2]},
        )
