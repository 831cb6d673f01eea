"""Cases of studies of following: their scenarios and their runs."""

from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario
from sonoservo.diagrams.studies.study import Case, WithFiles
from sonoservo.systems.evaluation.curve_error import curve_deviations
from sonoservo.systems.evaluation.log import encode_log
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

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


def run_case(case: Case) -> WithFiles:
    """Run a case's scenario.

    Parameters
    ----------
    case
        Case whose settings name a `scenario`, `changes` to it, and perhaps `as_published`.

    Returns
    -------
    `summary`: figures as in summary.json; `curve_deviation`: see `curve_deviations`, in m; and the
    log as a file.
    """
    experiment = FollowingExperiment(load_case(case))
    experiment.run()
    log, scenario = experiment.log(), experiment.scenario
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    result = {
        "summary": experiment.summarize(log),
        "curve_deviation": curve_deviations(log, geometry),
    }
    return WithFiles(result, {f"{case.name}.npz": encode_log(log)})
