"""Dials of the harder world, and the scenario that has them all at half strength."""

import pytest

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.dials import load_dials
from sonoservo.systems.files.typed_yaml import dump_typed

DIALS = load_dials()
OWN = {"phantom", "hand.azimuth_spread_deg", "scanner.needle.fading_db"}
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


def test_clinic_has_every_dial_at_half_strength():
    clinic = load_scenario("clinic")
    for dial in DIALS.values():
        for path, moderate in dial.moderate.items():
            if path in OWN or not isinstance(moderate, float):
                continue
            off = dial.plain.get(path, 0.0)
            turned = abs(field(clinic, path) - off) / abs(moderate - off)
            assert turned >= 0.5, path
    assert clinic.tissue_reaction.indentation
    assert clinic.phantom == "clinic"
