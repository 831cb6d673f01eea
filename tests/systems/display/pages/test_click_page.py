"""The page in which a person clicks on the needle: what it shows, takes and refuses."""

import io
import json
import threading
from base64 import b64decode

import numpy as np
import pytest
from page_clients.web_request import get, post
from PIL import Image
from pydrake.math import RigidTransform

from sonoservo.systems.display import Site
from sonoservo.systems.display.pages.click_page import ClickPage
from sonoservo.systems.signals import ImageSlice

ORIGIN, SPACING = [-0.01, 0.002], [0.4e-3, 0.2e-3]
"""Element [0, 0] of a slice of 51 x 101 elements: x from -10 to 10 mm, depth from 2 to 22 mm."""


@pytest.fixture
def site():
    with Site() as site:
        yield site


@pytest.fixture
def page(site):
    intensities = np.zeros((51, 101), np.uint8)
    intensities[10, 80] = 200
    return ClickPage(site, ImageSlice(intensities, ORIGIN, SPACING, RigidTransform(), 0.0))


def click(page, body):
    address, _, token = page.web_url.partition("?")
    return post(f"{address}click?{token}", body)[0]


def test_a_click_is_a_place_in_the_slice(page):
    waited = []
    thread = threading.Thread(target=lambda: waited.append(page.wait()))
    thread.start()
    assert click(page, json.dumps({"x": -1.5e-3, "y": 0.0123})) == 200
    thread.join(10)
    np.testing.assert_allclose(waited[0], [-1.5e-3, 0.0123])
    assert click(page, json.dumps({"x": 0.0, "y": 0.01})) == 409  # too late
    np.testing.assert_allclose(page.wait(), [-1.5e-3, 0.0123])


def test_the_page_shows_the_slice_where_it_lies(page):
    status, _, text = get(page.web_url)
    shown = json.loads(text.partition("const slice = ")[2].partition(";\n")[0])
    assert status == 200
    # Half an element around the centres of the outermost ones.
    np.testing.assert_allclose(shown["extent"], [-10.2, 1.9, 20.4, 20.2])
    kind, _, coded = shown["png"].partition(",")
    assert kind == "data:image/png;base64"
    with Image.open(io.BytesIO(b64decode(coded))) as picture:
        assert picture.size == (51, 101)  # x runs to the right, depth down
        assert picture.getpixel((10, 80)) == 200
        assert np.asarray(picture).sum() == 200


@pytest.mark.parametrize(
    "body",
    [
        "", "3", '{"x": 0.0}', '{"x": "left", "y": 0.01}', '{"x": NaN, "y": 0.01}',
        '{"x": 0.02, "y": 0.01}', '{"x": ' + 400 * "1" + ', "y": 0.01}', 2000 * "[",
    ],
)  # fmt: skip
def test_anything_else_is_refused_and_the_page_still_waits(page, body):
    assert click(page, body) == 400
    assert click(page, '{"x": 0.0, "y": 0.01}') == 200
    np.testing.assert_array_equal(page.wait(), [0.0, 0.01])


def test_only_those_who_know_the_token_can_click(page):
    address = page.web_url.partition("?")[0]
    assert post(f"{address}click", '{"x": 0.0, "y": 0.01}')[0] == 403
    whole = page.web_url.replace("/?", "/click?")
    assert post(whole, '{"x": 0.0, "y": 0.01}', Origin="http://elsewhere")[0] == 403
