"""Sequences of the study: their kinds, and how they are acquired once and kept."""

import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sonoservo.diagrams.benchmark.sequence import load_suites
from sonoservo.diagrams.experiments.following_scene import make_scene, observer_events
from sonoservo.diagrams.studies.robustness.planned_motion import MotionPlan, simulate_planned
from sonoservo.diagrams.studies.robustness.runs import scenario_of
from sonoservo.systems.evaluation.run_errors import at_times, in_frame
from sonoservo.systems.evaluation.run_logger import RunLogger
from sonoservo.systems.evaluation.success import conspicuous_length
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.signals.volume import acquired_from

SETTLED = 4.0
"""Time in s for which a sequence goes on after the first push."""


@dataclass(frozen=True)
class SearchingPlan(MotionPlan):
    """The probe moves to and fro over the phantom, at up to 6 mm/s and 4 deg/s, from 2 s on."""

    def _over(self, time):
        start = self.scenario.station.probe
        x, y, turn = np.sin(2 * np.pi * max(time - 2.0, 0.0) / np.array([31.0, 23.0, 37.0]))
        return self._placed((start.x + 0.025 * x, start.y + 0.012 * y, start.yaw_deg + 20 * turn))


FREE = "hand.start=1000.0"
WITHDRAWN = (
    "hand.pushes=[{duration: 5.0, speed: 0.01}, {duration: 1.0, speed: 0.0}, "
    "{duration: 4.0, speed: -0.0125}, {duration: 5.0, speed: 0.01}]"
)

KINDS = {
    "clinic": ("clinic", MotionPlan, (), None),
    "moving": ("clinic", SearchingPlan, ("hand.start=8.0",), None),
    "free": ("clinic", SearchingPlan, (FREE,), 20.0),
    "faint": ("faint", MotionPlan, ("scanner.needle.specular_db=28.0",), None),
    "fast": ("fast", MotionPlan, (), None),
    "wire": ("guide wire", MotionPlan, (), None),
    "withdrawn": ("clean", MotionPlan, (WITHDRAWN,), 17.0),
    "clean": ("clean", MotionPlan, (), None),
}
"""Suite, plan of the probe, changes and duration in s of each kind of sequence."""


@dataclass
class Recording:
    """Volumes, the (m, 3) points of the needle where each shows it in P, and what stands out.

    Parameters
    ----------
    volumes
        Volumes in order of time.
    needles
        (m, 3) points from entry to tip in P, None without a needle.
    conspicuous
        (v,) length of the needle that stands out, in m.
    """

    volumes: list
    needles: list
    conspicuous: np.ndarray


def acquire(kind, seed):
    """Return the `Recording` of a kind."""
    suite, plan, changes, until = KINDS[kind]
    settings = load_suites([suite])[suite].settings()
    settings["changes"] = [*settings["changes"], *changes]
    with scenario_of(settings, seed) as scenario:
        scene, looks = make_scene(scenario), observer_events(scenario)
        plan = plan(scenario, scene.insertion)
        logger, collector = RunLogger(geometry=scene.geometry), VolumeCollector(**looks)
        simulator = simulate_planned(
            scenario, scene, plan, {"volume_collector": collector, "run_logger": logger},
            until=until or plan.begin + SETTLED,
            optional={logger.get_input_port(k).get_name() for k in range(logger.num_input_ports())},
        )  # fmt: skip
        context = simulator.get_context()
        volumes = list(collector.volumes(collector.GetMyContextFromRoot(context)))
        log = logger.log(logger.GetMyContextFromRoot(context))
    return recording_of(volumes, log)


def recording_of(volumes, log):
    """Return the `Recording` of volumes and the log of their run."""
    times = np.array([volume.time for volume in volumes])
    poses, points = at_times(log, log.X_WP, times), at_times(log, log.needle_points, times)
    needles = []
    for n, volume in enumerate(volumes):
        needle = None
        if np.isfinite(points[n]).all():
            X = np.broadcast_to(poses[n], (len(points[n]), 4, 4))
            needle = acquired_from(volume, volume.X_WP.multiply(in_frame(X, points[n]).T).T)
        needles.append(needle)
    each = zip(volumes, needles, strict=True)
    shown = [0.0 if p is None else conspicuous_length(volume, p) for volume, p in each]
    return Recording(volumes, needles, np.array(shown))


def recorded(kind, seed, folder):
    """Return a `Recording`, acquired only if the folder does not have it."""
    path = Path(folder) / f"{kind}_{seed}.pickle"
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        recording = acquire(kind, seed)
        part = path.with_suffix(".part")
        with part.open("wb") as file:
            pickle.dump(recording, file, protocol=5)
        part.rename(path)
    with path.open("rb") as file:
        return pickle.load(file)
