"""A new experiment is a module and a line in the registry."""

import sys
from dataclasses import dataclass
from types import ModuleType
from typing import ClassVar

import numpy as np
import pytest
from matplotlib.figure import Figure
from pydrake.systems.framework import LeafSystem

from sonoservo.diagrams import Experiment, Scenario, load_scenario, run
from sonoservo.diagrams.experiments import registry
from sonoservo.diagrams.experiments.presenter import Presenter
from sonoservo.systems.evaluation import read_log
from sonoservo.systems.evaluation.log import Array, Log, column


@dataclass(kw_only=True)
class TickingScenario(Scenario):
    experiment: str = "ticking"
    duration: float = 1.0
    period: float = 0.25


@dataclass(frozen=True, eq=False, kw_only=True)
class TickingLog(Log):
    time: Array = column("time of the tick", "s", "n")


class Clock(LeafSystem):
    def __init__(self):
        super().__init__()
        self.DeclareVectorOutputPort(
            "time", 1, lambda context, output: output.SetFromVector([context.get_time()])
        )


class TickingExperiment(Experiment):
    """Notes the time four times a second."""

    scenario_class = TickingScenario

    def __init__(self, scenario):
        self.clock = Clock()
        super().__init__(
            scenario,
            {"clock": self.clock},
            period=scenario.period,
            offset=scenario.period,
            stages={"look": (self.clock, "time")},
            event="tick",
        )

    def _begin(self):
        super()._begin()
        self.ticks = []

    def _after_step(self, number):
        self.ticks.append(float(self.evaluate(self.clock, "time")[0]))

    @property
    def status(self):
        return "ticking"

    def log(self):
        return TickingLog(time=np.array(self.ticks))

    def summarize(self, log):
        return {"ticking": {"count": len(log.time)}}

    def results(self):
        return {"last": self.ticks[-1]}


class TickingPresenter(Presenter):
    labels: ClassVar = {"ticking.count": "number of ticks"}

    def plots(self, log):
        return {"ticks.png": ("ticks", Figure())}


@pytest.fixture
def path(monkeypatch, tmp_path):
    module = ModuleType("sonoservo.diagrams.experiments.ticking")
    module.TickingExperiment = TickingExperiment
    monkeypatch.setitem(sys.modules, module.__name__, module)
    presenter = ModuleType(f"{module.__name__}_presenter")
    presenter.TickingPresenter = TickingPresenter
    monkeypatch.setitem(sys.modules, presenter.__name__, presenter)
    known = {**registry.EXPERIMENTS, "ticking": "Ticking"}
    monkeypatch.setattr(registry, "EXPERIMENTS", known)
    path = tmp_path / "clock.yaml"
    path.write_text("experiment: ticking\npublished_figures: {ticking.count: 3}\n")
    return path


def test_a_new_experiment_runs_as_the_others_do(path, tmp_path):
    scenario = load_scenario(path, changes=["duration=0.5"])
    assert isinstance(scenario, TickingScenario)
    seen = []
    result = run(scenario, out=tmp_path / "out", after_step=lambda each: seen.append(each.status))
    assert seen == 2 * ["ticking"]  # the step that is due at the end is made, too
    assert result.summary["simulated_s"] == pytest.approx(0.5, abs=1e-5)
    assert result.results["last"] == result.log.time[-1] == pytest.approx(0.5, abs=1e-5)
    log = read_log(tmp_path / "out" / "log.npz", TickingLog)
    np.testing.assert_array_equal(log.time, result.log.time)
    assert load_scenario(tmp_path / "out" / "scenario.yaml") == scenario
    with pytest.raises(ValueError, match="tracker: not possible in the experiment 'ticking'"):
        run(scenario, tracker=Clock())
