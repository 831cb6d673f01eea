"""Requests to a page, as a browser makes them."""

from urllib.error import HTTPError
from urllib.request import Request, urlopen


def get(url, **headers):
    """Status, headers and text of the answer."""
    return _ask(Request(url, headers=headers))


def post(url, text, **headers):
    """Send a text; status, headers and text of the answer."""
    return _ask(Request(url, data=text.encode(), headers=headers))


def _ask(request):
    try:
        answer = urlopen(request, timeout=10)
    except HTTPError as error:
        answer = error
    with answer:
        return answer.status, answer.headers, answer.read().decode()
