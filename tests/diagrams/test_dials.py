"""Dials of the harder world, and the scenario that has them all at half strength."""

import pytest

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.dials import load_dials
from sonoservo.systems.files.typed_yaml import dump_typed

DIALS = load_dials()
"""Fields of clinic that are not at half strength: names, and what has no half."""


def field(scenario, path):
    for name in path.split("."):
        scenario = scenario[int(name)] if name.isdigit() else getattr(scenario, name)
    return scenario


@pytest.mark.parametrize("name", DIALS)
def test_a_dial_sets_fields_of_a_scenario(name):
    dial = DIALS[name]
    plain = load_scenario("chatelain2013_fig5")
    turned = load_scenario("chatelain2013_fig5", changes=dial.changes())
    assert dump_typed(plain) != dump_typed(turned)
    for path, moderate in dial.moderate.items():
        assert field(turned, path) == moderate
        if isinstance(moderate, float):
            off, half = dial.plain.get(path, 0.0), dial.changes(0.5)
            assert f"{path}={off + 0.5 * (moderate - off)}" in half
            if path != "hand.pushes.0.speed":
                assert field(plain, path) in (off, 5.0)  # the papers' needles dip by 5 deg
