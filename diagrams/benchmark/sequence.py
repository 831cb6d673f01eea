"""Sequence of the benchmark: volumes of a planned motion with a forced loss, and the truth."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import make_scene, observer_events
from sonoservo.diagrams.scenario import draw_seeds
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan, simulate_planned
from sonoservo.diagrams.studies.robustness.runs import PLAIN, scenario_of
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.typed_yaml import read_yaml, suggest
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.signals.requirements import require
from sonoservo.systems.signals.volume import Volume

_BEFORE, _LIFTED, _AFTER = 5.0, 2.0, 4.0
"""Times in s from the first push's end to the forced loss, of the loss, and after it."""

_LIFT, _RAMP = 0.015, 0.4
"""Height of the lifted probe over where it rode, in m, and time of lifting it, in s."""


@dataclass(frozen=True)
class LiftedPlan(MotionPlan):
    """Planned motion with a forced loss: for two seconds the probe is off the skin."""

    @property
    def lifted(self) -> tuple[float, float]:
        """Times in s between which the probe is on its way up, off the skin or on its way down."""
        begin = self.begin if self.begin < self.scenario.duration else 8.25
        return begin + _BEFORE, begin + _BEFORE + _LIFTED

    def probe(self, time: float) -> RigidTransform:
        """Return the true pose X_WP of the probe."""
        up, down = self.lifted
        height = _LIFT * float(np.clip(min(time - up, down - time) / _RAMP, 0, 1))
        return super().probe(time) @ RigidTransform([0, -height, 0])


@dataclass(frozen=True, eq=False)
class Sequence:
    """Volumes of a sequence in order of time, with the poses as measured, and the truth."""

    volumes: list[Volume]
    truth: RunLog  # log of the run without estimates
    lifted: tuple[float, float]  # between which the probe is lifted, in s
    tracker_seed: int  # for the random choices of a tracker
    needle_radius: float  # in m


def acquire_sequence(settings: Mapping[str, Any], seed: int) -> Sequence:
    """Simulate a sequence of a suite, given its `Suite.settings` and a seed."""
    with scenario_of(settings, seed) as scenario:
        return _acquire(scenario)


def _acquire(scenario: FollowingScenario) -> Sequence:
    scene, looks = make_scene(scenario), observer_events(scenario)
    plan = LiftedPlan(scenario, scene.insertion)
    logger = RunLogger(geometry=scene.geometry)
    collector = VolumeCollector(**looks)
    unlogged = {logger.get_input_port(k).get_name() for k in range(logger.num_input_ports())}
    simulator = simulate_planned(
        scenario,
        scene,
        plan,
        {"volume_collector": collector, "run_logger": logger},
        until=plan.lifted[1] + _AFTER,
        optional=unlogged,
    )
    context = simulator.get_context()
    return Sequence(
        volumes=collector.volumes(collector.GetMyContextFromRoot(context)),
        truth=logger.log(logger.GetMyContextFromRoot(context)),
        lifted=plan.lifted,
        tracker_seed=draw_seeds(scenario).tracker,
        needle_radius=scene.insertion.needle(0.0).radius,
    )


VERSION = 1  # version of the suites; another one means that scores do not compare
SEQUENCES = 20  # number of sequences in a suite
_SALTED = 1000  # distance of the seeds of one salt from those of the next


@dataclass(frozen=True)
class Suite:
    """One difficulty of the benchmark: changes in a scenario, and a phantom with changed fields."""

    line: str  # description for a person
    scenario: str = "chatelain2013_fig5"
    changes: tuple[str, ...] = ()
    phantom: str = ""
    phantom_changes: Mapping[str, Any] = field(default_factory=dict)

    def settings(self) -> dict[str, Any]:
        """Return the settings of a case of this suite; see `scenario_of`."""
        plain = () if self.scenario == "clinic" else (*PLAIN, "hand.start=2.0")
        return {
            "scenario": self.scenario,
            "changes": [*plain, *self.changes],
            "phantom": self.phantom,
            "phantom_changes": dict(self.phantom_changes),
        }


def load_suites(names: Collection[str] = ()) -> dict[str, Suite]:
    """Return suites by name; all of them if none is named."""
    path = Path(str(files("sonoservo.diagrams.benchmark"))) / "suites.yaml"
    known = {name: Suite(**each) for name, each in read_yaml(path).items()}
    for name in names:
        if name not in known:
            raise ConfigurationError(f"unknown suite {name!r}; {suggest(name, known)}")
    return {name: suite for name, suite in known.items() if not names or name in names}


def sequence_seeds(salt: int = 0, count: int = SEQUENCES) -> range:
    """Return the seeds of a suite's sequences: 0 and up, or 1000 times the salt and up."""
    require(salt >= 0, "salt", salt, "0 or more")
    require(1 <= count <= SEQUENCES, "sequences", count, f"from 1 to {SEQUENCES}")
    return range(_SALTED * salt, _SALTED * salt + count)
