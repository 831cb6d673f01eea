"""What holds for every experiment: the registry, the driver, and who sees the truth."""

import numpy as np
import pytest
from pydrake.common.value import Value
from pydrake.systems.framework import LeafSystem

from sonoservo.diagrams import load_scenario, make_experiment, run, scan, tracker_events
from sonoservo.diagrams.experiments.registry import EXPERIMENTS, experiment_class, present
from sonoservo.diagrams.studies import make_dataset
from sonoservo.systems.evaluation.log import columns
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals import NeedleEstimate, TrackingMode

SCENARIOS = {
    "following": ("chatelain2013_fig5", ["duration=1.5", "station.plant.contact_model=point"]),
    "shape_prediction": ("carriere2016_patient", ["depth=0.03", "observe_until=0.02"]),
}
BLIND = {"following": {"needle_tracker", "probe_controller"},
         "shape_prediction": {"shape_predictor"}}  # fmt: skip


def assert_equal_logs(first, second):
    assert type(first) is type(second)
    for name in columns(type(first)):
        if not name.endswith("_s"):  # computing times
            np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)


@pytest.fixture(scope="module", params=sorted(EXPERIMENTS))
def driven(request):
    """An experiment that has run, what was seen of it, and its log."""
    name, changes = SCENARIOS[request.param]
    experiment, seen = make_experiment(load_scenario(name, changes=changes, seed=103)), []
    assert experiment.scenario.experiment == request.param
    experiment.run(lambda each: seen.append((each.time, each.status)))
    return experiment, seen, experiment.log()


def test_a_second_start_in_other_strides_of_time_gives_the_same_run_again(driven):
    experiment, first, log = driven
    count, again = len(first), []
    assert count > 2
    experiment.start()
    assert all(times == [] for times in experiment.compute.values())
    while experiment.time < (end := experiment.scenario.duration):
        experiment.advance(
            min(experiment.time + 0.13, end), lambda each: again.append((each.time, each.status))
        )
    assert again == first
    assert_equal_logs(experiment.log(), log)
    assert {len(times) for times in experiment.compute.values()} == {count}


def test_every_figure_of_the_table_is_in_the_summary(driven):
    experiment, _, log = driven
    shown = {path.split(".")[0] for path in present(experiment).labels}
    assert shown <= experiment.summarize(log).keys() | {"compute_ms", "real_time_factor"}


def test_trackers_and_controllers_never_see_the_truth(driven):
    experiment, *_ = driven
    systems = {system.get_name(): system for system in experiment.diagram.GetSystems()}
    ports = {
        systems[name].get_input_port(index).get_name()
        for name in BLIND[experiment.scenario.experiment]
        for index in range(systems[name].num_input_ports())
    }
    assert ports <= {
        "volume", "estimate", "X_WP", "wrist_force", "joint_state", "gain", "force_target",
        "slice", "shape", "cross_section", "external_torque", "confirmation",
    }  # fmt: skip


class Spy(LeafSystem):
    """A tracker that asks for more than volumes."""

    def __init__(self):
        super().__init__()
        for name in ("volume", "needle"):
            self.DeclareAbstractInputPort(name, Value[object]())
        estimate = NeedleEstimate(TrackingMode.SEARCHING, 0.0)
        index = self.DeclareAbstractState(Value[object](estimate))
        self.DeclareStateOutputPort("estimate", index)


def test_a_tracker_that_spies_is_refused():
    scenario = load_scenario("chatelain2013_fig5", changes=["duration=1"])
    message = "needle_tracker has an input 'needle', which is the truth"
    with pytest.raises(ConfigurationError, match=message):
        run(scenario, tracker=Spy())


def test_an_unknown_experiment_is_one_clear_line():
    with pytest.raises(ConfigurationError, match=r"'folowing' is .*; did you mean 'following'\?"):
        experiment_class("folowing")
    with pytest.raises(ConfigurationError, match=r"drive: experiment: 7 is not allowed; known: "):
        load_scenario("drive", changes=["experiment=7"])


@pytest.mark.parametrize(
    "use",
    [
        scan,
        tracker_events,
        lambda scenario: make_dataset(scenario, None, count=1),
        experiment_class("following"),
    ],
)
def test_what_needs_a_scenario_of_following_says_so(use):
    with pytest.raises(ConfigurationError) as error:
        use(load_scenario("carriere2016_d80"))
    assert str(error.value) == (
        "carriere2016_d80: a scenario of the experiment 'shape_prediction'; "
        "one of 'following' is needed here"
    )
