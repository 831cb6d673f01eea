"""Runs of studies of following."""

from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.studies.following.analysis import describe_run, load_case
from sonoservo.diagrams.studies.study import Case, WithFiles
from sonoservo.systems.evaluation.log import encode_log
from sonoservo.systems.ultrasound.imaging import sweep_geometry
from sonoservo.systems.ultrasound.transducer import load_transducer

AS_PUBLISHED = ", as published"  # ending of the name of an experiment with the published method


def run_case(case: Case) -> WithFiles:
    """Run a case's scenario; return summary and `describe_run`, and the log as a file."""
    experiment = FollowingExperiment(load_case(case))
    experiment.run()
    log, scenario = experiment.log(), experiment.scenario
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    result = {"summary": experiment.summarize(log), **describe_run(log, scenario, geometry)}
    return WithFiles(result, {f"{case.name}.npz": encode_log(log)})
