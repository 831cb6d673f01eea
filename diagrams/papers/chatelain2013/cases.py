"""Cases of the reproduction of Chatelain 2013, and their scenarios."""

from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.studies.study import Case

AS_PUBLISHED = ", as published"
"""Ending of the name of an experiment with the published method."""


def load_case(case: Case) -> Scenario:
    """Return the scenario of a case, with the published method if the case asks for it."""
    settings = case.settings
    return load_scenario(
        settings["scenario"],
        seed=case.seed,
        changes=list(settings["changes"]),
        as_published=bool(settings.get("as_published", False)),
    )
