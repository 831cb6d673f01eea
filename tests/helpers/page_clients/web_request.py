"""Requests to a page, as a browser makes them."""

from urllib.error import HTTPError
from urllib.request import Request, urlopen


def get(url, **headers):
    """Status, headers and text of the answer."""
    try:
        answer = urlopen(Request(url, headers=headers), timeout=10)
    except HTTPError as error:
        answer = error
    with answer:
        return answer.status, answer.headers, answer.read().decode()
