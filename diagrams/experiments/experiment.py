"""Base class of the experiments: a scenario as a diagram, its simulation, and its results."""

import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Mapping, Sequence
from typing import Any, ClassVar, Generic, Self

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, System

from sonoservo.diagrams.scenario import Scenario, ScenarioT
from sonoservo.diagrams.wiring import connect_by_name
from sonoservo.systems.evaluation.compile_free_clock import FIRST_USE, CompileFreeClock
from sonoservo.systems.evaluation.log import Log
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.signals.immutable import NotFound
from sonoservo.systems.signals.ports import DiagramBuilder

INSTANT = 1e-6  # time in s between an event and an observation just before or after it

_started_in: list[int] = []
"""Number of the process that has run a simulation, and therefore threads."""


def _refuse_after_fork() -> None:
    """Raise ConfigurationError in a child that was forked after a run, and would wait for ever."""
    if not _started_in:
        _started_in.append(os.getpid())
    elif _started_in[0] != os.getpid():
        raise ConfigurationError(
            "this process was forked from one that has run a simulation, and its threads did not "
            "come along; start it by 'spawn' or 'forkserver' (multiprocessing.get_context)"
        )


class Experiment(ABC, Generic[ScenarioT]):
    """A scenario as one diagram, and its simulation in steps of one volume or slice each.

    .. pydrake_system::

        name: (the scenario's)

    Every input of a subsystem is connected to the output of the same name. A ValueError names the
    field with which a scenario cannot be carried out.

    Parameters
    ----------
    scenario, systems
        Scenario, and subsystems of the diagram by name.
    period, offset
        Period of the volumes or slices and time of the first one, in s.
    stages, event
        Timed stages of a volume's computation: name, and system and output port that are evaluated
        just before the event; and the name of what is computed at the event itself.
    background
        Total time in s so far of a stage's work, for stages that work in the background too.
    clock
        Clock of the stages, in s. The first use of a kernel in a process is not counted.
    optional, sees_truth
        Inputs that need no output, and systems that may see the truth; see `connect_by_name`.
    """

    scenario_class: ClassVar[type[Scenario]]
    options: ClassVar[frozenset[str]] = frozenset({"meshcat"})
    log_class: ClassVar[type[Log]]

    def __init__(
        self,
        scenario: ScenarioT,
        systems: Mapping[str, System],
        *,
        period: float,
        offset: float,
        stages: Mapping[str, tuple[System, str]],
        event: str,
        background: Mapping[str, Callable[[], float]] | None = None,
        clock: Callable[[], float] = time.perf_counter,
        optional: Container[str] = (),
        sees_truth: Container[str] = (),
    ) -> None:
        self.scenario = scenario
        self._period, self._offset = period, offset
        self._stages, self._event, self._clock = stages, event, CompileFreeClock(clock, FIRST_USE)
        self._background = background or {}
        builder = DiagramBuilder()
        for name, system in systems.items():
            builder.AddNamedSystem(name, system)
        connect_by_name(builder, systems, optional=optional, sees_truth=sees_truth)
        self.diagram = builder.Build()
        self.diagram.set_name(scenario.name)
        self._simulator = Simulator(self.diagram)
        self._begin()

    # Defined by each experiment.

    @property
    @abstractmethod
    def status(self) -> str:
        """Present status of the tracker, in a word or two, for a progress bar."""

    @abstractmethod
    def log(self) -> Log:
        """Return the log so far; it is empty before the first step."""

    @abstractmethod
    def summarize(self, log: Any) -> dict[str, Any]:
        """Return the figures of a log of this experiment, as in summary.json."""

    @property
    def repeatable(self) -> bool:
        """Whether the scenario alone repeats the run."""
        return True

    @property
    def pictures(self) -> Sequence[Any]:
        """Pictures of the volumes so far; none unless the experiment has volumes and keeps them."""
        return ()

    def results(self) -> dict[str, Any]:
        """Return results of the run that are neither in the log nor in the summary, by name."""
        return {}

    def happened(self) -> ScenarioT:
        """Return the scenario that repeats the run so far."""
        return self.scenario

    def close(self) -> None:
        """Finish the files that the experiment itself writes, such as a recording."""

    def _after_step(self, number: int) -> None:
        """Record the results of a step; steps are counted from 0."""

    # The simulation.

    def run(
        self, after_step: Callable[[Self], None] | None = None, real_time: bool = False
    ) -> None:
        """Simulate the whole scenario."""
        self.start(real_time=real_time)
        self.advance(self.scenario.duration, after_step)

    def start(self, *, real_time: bool = False) -> None:
        """Start at time zero; after a run, restart from the initial state."""
        _refuse_after_fork()
        # A new context, because a plant keeps its last contact forces in one that is only reset.
        self._simulator.reset_context(self.diagram.CreateDefaultContext())
        self._begin()
        self._simulator.set_target_realtime_rate(1.0 if real_time else 0.0)
        self._simulator.Initialize()

    def advance(self, time: float, after_step: Callable[[Self], None] | None = None) -> None:
        """Simulate up to a time in s, including a step due at that time; call `start` first."""
        with self._clock:
            while (due := self._offset + self._steps * self._period) < time + INSTANT:
                self._simulator.AdvanceTo(due - INSTANT)
                made = self._make_step(due)
                if made:
                    self._after_step(self._steps)
                self._steps += 1
                if made and after_step is not None:
                    after_step(self)
            self._simulator.AdvanceTo(max(time, self.time))

    def set_speed(self, speed: float) -> None:
        """Go on at a multiple of real time, or as fast as possible at 0; forgive earlier delays."""
        self._simulator.set_target_realtime_rate(speed)
        self._simulator.ResetStatistics()

    def forgive_delay(self) -> None:
        """Continue in real time from now on, without making up for lost time."""
        self._simulator.ResetStatistics()

    @property
    def simulator(self) -> Simulator:
        """Simulator of the diagram, for a program that advances it by itself."""
        return self._simulator

    @property
    def time(self) -> float:
        """Simulated time so far, in s."""
        return self._simulator.get_context().get_time()

    @property
    def compute(self) -> Mapping[str, list[float]]:
        """Computing time of each step so far in s, by stage."""
        return self._compute

    def context_of(self, system: System) -> Context:
        """Return the present context of one of the subsystems."""
        return system.GetMyContextFromRoot(self._simulator.get_context())

    def evaluate(self, system: System, port: str) -> Any:
        """Return the present value of an output port of one of the subsystems."""
        return system.GetOutputPort(port).Eval(self.context_of(system))

    def _begin(self) -> None:
        """Clear the steps of an earlier run."""
        self._steps = 0
        self._newest: Any = None
        self._compute: dict[str, list[float]] = {name: [] for name in (*self._stages, self._event)}
        self._worked = {name: total() for name, total in self._background.items()}
        self._compiled = self._clock.compiled

    def _make_step(self, due: float) -> bool:
        """Compute the volume or slice and the estimate that are due; False if there is no new one.

        The ports are evaluated and timed just before the event, which then finds them in the cache;
        at the event itself, the plant makes at most one step.
        """
        clock, values = [self._clock()], []
        for system, port in self._stages.values():
            values.append(self.evaluate(system, port))
            clock.append(self._clock())
        self._simulator.AdvanceTo(due + INSTANT)
        clock.append(self._clock())
        if values[0] is self._newest or isinstance(values[0], NotFound):
            return False
        self._newest = values[0]
        seconds = dict(zip(self._compute, np.diff(clock).tolist(), strict=True))
        compiled, self._compiled = self._clock.compiled - self._compiled, self._clock.compiled
        for name, total in self._background.items():
            before, self._worked[name] = self._worked[name], total()
            seconds[name] = max(self._worked[name] - before - compiled, 0.0)
        for name, each in seconds.items():
            self._compute[name].append(float(each))
        return True
