"""Runs of the study of robustness: one scene for all trackers, or the loop of one of them."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from sonoservo.diagrams.dials import load_dials
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import make_scene, observer_events
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import require_scenario
from sonoservo.diagrams.studies.robustness.planned_motion import make_bench, run_open_loop
from sonoservo.diagrams.studies.robustness.search_path import SearchPath
from sonoservo.diagrams.studies.study import Case
from sonoservo.diagrams.tracker_bench import log_of
from sonoservo.systems.evaluation.metrics import detection
from sonoservo.systems.evaluation.run_errors import at_times, in_frame, inside_stated
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.evaluation.success import conspicuous_length, judged_errors
from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import apply_changes, read_yaml
from sonoservo.systems.recording.volume_collector import VolumeCollector
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.volume import Volume, acquired_from

GRADED = load_dials()

PUSHED = 0.05  # length of the first push in m; a faster hand pushes for less time
_SPEED = 0.008  # speed of the hand while its dial is off, in m/s

PLAIN = (
    "station.probe={x: 0.0, y: 0.0, yaw_deg: 20.0, height: 0.010}",
    "hand.entry=null",
    "hand.entry_spread=[0, 0, 0]",
    f"hand.pushes=[{{duration: {PUSHED / _SPEED}, speed: {_SPEED}}}, "
    "{duration: 3.0, speed: 0.005}]",
)
"""Changes that turn fig. 5 into the scenario in which every dial is off: the needle comes from
outside the view and passes 45 mm below the probe, which is turned by 20 deg."""

CLINIC = "clinic"  # name of the scenario that has all dials at about half their moderate strength


def turned(name: str, strength: float) -> dict[str, Any]:
    """Return the settings of a case with one dial turned; see `scenario_of`."""
    dial = GRADED[name]
    if dial.phantom_field:
        phantom = {"phantom": dial.moderate["phantom"]}
        return {"changes": [], **phantom, "phantom_changes": dial.phantom_changes(strength)}
    changes = dial.changes(strength)
    if name == "speed":
        changes.append(f"hand.pushes.0.duration={PUSHED / (1e-3 * dial.quantity(strength))}")
    return {"changes": changes}


@contextmanager
def scenario_of(settings: Mapping[str, Any], seed: int) -> Iterator[FollowingScenario]:
    """Load the scenario of a case; the file of a changed phantom exists until the end."""
    with TemporaryDirectory() as folder:
        changes = list(settings["changes"])
        if settings.get("phantom"):
            data = read_yaml(model_file("phantoms", settings["phantom"]))
            apply_changes(data, dict(settings["phantom_changes"]))
            path = Path(folder) / "phantom.yaml"
            path.write_text(yaml.safe_dump(data), encoding="utf-8")
            changes.append(f"phantom={path}")
        loaded = load_scenario(settings["scenario"], changes=changes, seed=seed)
        yield require_scenario(loaded, FollowingScenario)


OURS, PUBLISHED, ZHAO = "chatelain2013", "chatelain2013_as_published", "zhao2012"
TRACKERS = (OURS, PUBLISHED, ZHAO)
"""Kinds of the trackers that are compared, of which any number may follow the first two."""

SEARCH_START = 5.0  # time in s at which a probe that searches begins to move; it has landed by then
_SHOWN = 0.5e-3  # length in the image up to which there is no needle to be seen, in m

_FOLLOWED = (TrackingMode.TRACKING, TrackingMode.COASTING)

Floats = NDArray[np.float64]


def run_case(case: Case) -> Mapping[str, Any]:
    """Run a case, and return the record of each tracker by its kind; see `record`."""
    settings = case.settings
    trackers = settings["trackers"]
    with scenario_of(settings, case.seed) as scenario:
        if settings["loop"] == "open":
            corrects = bool(settings.get("correct_poses"))
            logs, volumes = run_open_loop(scenario, trackers, correct_poses=corrects)
        elif settings["loop"] == "closed":
            log, volumes = _run_closed_loop(scenario)
            logs = {trackers[0]: log}
        else:
            logs, volumes = _run_search(scenario, trackers), []
    judged = {name: bool(settings.get(name)) for name in ("in_probe", "across_depth")}
    return {kind: record(log, volumes, **judged) for kind, log in logs.items()}


def _run_closed_loop(scenario: FollowingScenario) -> tuple[RunLog, list[Volume]]:
    """Return the log of a run in which the robot follows the tracker, and its volumes."""
    collector = VolumeCollector(**observer_events(scenario))
    experiment = FollowingExperiment(scenario, observers={"volume_collector": collector})
    experiment.run()
    return experiment.log(), collector.volumes(experiment.context_of(collector))


def _run_search(scenario: FollowingScenario, trackers: Sequence[str]) -> dict[str, RunLog]:
    """Return the logs of a run in which our tracker moves the probe, with others beside it."""
    geometry = make_scene(scenario).geometry
    observers = {kind: make_bench(scenario, geometry, kind) for kind in trackers if kind != OURS}
    experiment = FollowingExperiment(
        scenario,
        search=SearchPath(station=scenario.station, start=SEARCH_START),
        observers={f"{kind}_observer": each for kind, each in observers.items()},
    )
    experiment.run()
    logs = {kind: log_of(each, experiment.context_of(each)) for kind, each in observers.items()}
    return {kind: logs.get(kind) or experiment.log() for kind in trackers}


def record(
    log: RunLog,
    volumes: Sequence[Volume] = (),
    *,
    in_probe: bool = False,
    across_depth: bool = False,
) -> dict[str, Any]:
    """Return what a study keeps of a tracker's run.

    With `in_probe`, errors and false starts are those in the probe's frame; with `across_depth`,
    errors count across the depth only. `conspicuous_mm`: length that stands out in each volume;
    `shown_s`, `travel_mm`: time for which a needle is shown, and travel that the servo commands,
    while there is none.
    """
    conspicuous = conspicuous_lengths(log, volumes)
    log = as_in_probe(log) if in_probe else log
    tip, axis = judged_errors(log, across_depth=across_depth)
    shown = np.isin(log.estimate_mode, _FOLLOWED)
    ghost = shown & (np.nan_to_num(log.visible_length) < _SHOWN)
    steps = np.diff(log.time, append=log.time[-1:])
    speed = np.linalg.norm(log.planar_velocity[:, :2], axis=1)
    travel = float((steps * np.nan_to_num(speed))[ghost].sum())
    return {
        "tip_mm": 1e3 * tip,
        "axis_deg": np.rad2deg(axis),
        "tracking": log.volume_estimate_mode == TrackingMode.TRACKING,
        "conspicuous_mm": 1e3 * conspicuous,
        "false_starts": detection(log)["false_starts"],
        "seconds": float(log.time[-1]),
        "shown_s": float(steps[ghost].sum()),
        "travel_mm": 1e3 * travel if np.isfinite(speed).any() else None,
        "inside": inside_stated(log, across_depth=across_depth),
    }


def conspicuous_lengths(log: RunLog, volumes: Sequence[Volume]) -> Floats:
    """Return (v,) lengths in m of the true needle that stand out; 0 without needle or volume."""
    time = log.volume_time
    true_X, points = at_times(log, log.X_WP, time), at_times(log, log.needle_points, time)
    by_time = {each.time: each for each in volumes}
    lengths = np.zeros(len(time))
    for n in range(len(time)):
        volume = by_time.get(float(time[n]))
        if volume is not None and np.isfinite(points[n]).all():
            # The volume shows the needle where it lay in P; its measured poses may be wrong.
            p_P = in_frame(np.broadcast_to(true_X[n], (points.shape[1], 4, 4)), points[n])
            shown = acquired_from(volume, volume.X_WP.multiply(p_P.T).T)
            lengths[n] = conspicuous_length(volume, shown)
    return lengths


def as_in_probe(log: RunLog) -> RunLog:
    """Return a log whose estimates lie in W where the probe's measured pose has them in P.

    Errors of the pose itself do not count then; apparent motion of the needle still does, if a
    probe with a wrong pose moves.
    """
    time = log.volume_estimate_time
    true_X, measured_X = (at_times(log, each, time) for each in (log.X_WP, log.measured_X_WP))

    def moved(p_W: Floats) -> Floats:
        p_P = in_frame(measured_X, p_W)
        return np.asarray(np.einsum("nij,nj->ni", true_X[:, :3, :3], p_P) + true_X[:, :3, 3])

    turn = true_X[:, :3, :3] @ np.swapaxes(measured_X[:, :3, :3], 1, 2)

    def turned(covariance: Floats) -> Floats:
        return turn @ covariance @ np.swapaxes(turn, 1, 2)

    return replace(
        log,
        volume_estimate_tip=moved(log.volume_estimate_tip),
        volume_estimate_entry=moved(log.volume_estimate_entry),
        volume_estimate_velocity=np.einsum("nij,nj->ni", turn, log.volume_estimate_velocity),
        volume_estimate_tip_covariance=turned(log.volume_estimate_tip_covariance),
        volume_estimate_direction_covariance=turned(log.volume_estimate_direction_covariance),
        volume_estimate_velocity_covariance=turned(log.volume_estimate_velocity_covariance),
    )
