"""The scene for 3D Slicer names what is sent."""

from importlib.resources import files
from xml.etree import ElementTree

from sonoservo.systems.live.connection.address import DEFAULT_PORT
from sonoservo.systems.live.feeds import IMAGE, NEEDLE, SLICES, TIP, NeedleNames
from sonoservo.systems.live.image_matcher import DEFAULT_POSES


def test_scene_connects_and_places_the_images_under_the_probe():
    text = (files("sonoservo.systems.live") / "slicer.mrml").read_text()
    nodes = {node.get("name"): node for node in ElementTree.fromstring(text)}
    connector = nodes["sonoservo"]
    assert connector.tag == "IGTLConnector"
    assert int(connector.get("serverPort")) == DEFAULT_PORT
    names = NeedleNames()
    expected = {IMAGE, *SLICES, DEFAULT_POSES, names.tip, names.curve, NEEDLE, TIP}
    assert expected == nodes.keys() - {"sonoservo", None}
    for name in (IMAGE, *SLICES):
        assert nodes[name].get("references") == f"transform:{nodes[DEFAULT_POSES].get('id')};"
