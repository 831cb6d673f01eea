"""Acquisition of one sweep of a scenario, without a robot."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydrake.math import RigidTransform

from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.following_scene import check_entry, make_insertion
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.scene import Scene
from sonoservo.systems.evaluation.reports.plots import png
from sonoservo.systems.evaluation.reports.scan_sheet import scan_sheet
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.files.writing import write_atomically
from sonoservo.systems.recording.nrrd import write_volume
from sonoservo.systems.signals.needle import Needle
from sonoservo.systems.signals.requirements import require_not_negative
from sonoservo.systems.signals.sweep import Sweep, SweepGeometry, SweepMotion
from sonoservo.systems.signals.volume import Volume
from sonoservo.systems.ultrasound.scan_conversion import ScanConversion, make_grid

_INDENTATION = 4e-3  # Indentation of the phantom by a dome of 40 mm radius at 2 N, in m


@dataclass(frozen=True, eq=False)
class Scan:
    """A sweep as acquired, its volume, the true needle in W at its middle, and its settings."""

    sweep: Sweep
    volume: Volume
    needle: Needle
    caption: str = ""

    def plot(self) -> Figure:
        """Return a figure of a frame as acquired, and of slices through the needle."""
        return scan_sheet(self.sweep, self.volume, self.needle, caption=self.caption)

    def _repr_html_(self) -> str:
        picture = base64.b64encode(png(self.plot(), dpi=80)).decode()
        alternative = escape(f"Slices of a sweep. {self.caption}")
        return (
            f'<img src="data:image/png;base64,{picture}" alt="{alternative}" style="width: 100%">'
        )


def scan(
    scenario: Scenario | str | Path,
    *,
    changes: Mapping[str, Any] | Sequence[str] | None = None,
    seed: int | None = None,
    time: float | None = None,
    X_TP: RigidTransform | None = None,
    velocity: Sequence[float] = (0.0, 0.0, 0.0),
) -> Scan:
    """Acquire one sweep towards +Z.

    Phantom, needle and tissue are those of a run with the same seed.

    Parameters
    ----------
    scenario, changes, seed
        Scenario of following, the name of a built-in one, or the path of a YAML file; fields to
        change, and the seed; see `load_scenario`. Its robot is not used.
    time
        Time of the middle of the sweep, in s; None for the time at which the needle is deepest.
    X_TP
        Pose of the probe in the phantom at that time. By default, the probe is pressed on the
        phantom as at 2 N, over the needle's tip, with the scenario's initial orientation. If no
        needle is in the phantom, it is over the scenario's initial position.
    velocity
        (3,) velocity of the probe during the sweep, along the axes of P, in m/s.

    Raises
    ------
    ConfigurationError
        If the scenario cannot be carried out.
    """
    loaded = load_scenario(scenario, changes=changes, seed=seed)
    following = require_scenario(loaded, FollowingScenario)
    try:
        return _scan(following, time, X_TP, velocity)
    except (ValueError, FileNotFoundError) as error:
        raise ConfigurationError(f"{following.name}: {error}") from error


def _scan(
    scenario: FollowingScenario,
    time: float | None,
    X_TP: RigidTransform | None,
    velocity: Sequence[float],
) -> Scan:
    insertion = make_insertion(scenario)
    scene = Scene.of(scenario, insertion, reaction=scenario.tissue_reaction)
    deepest = float(max(np.linspace(0, scenario.duration, 200), key=insertion.depth))
    whole, surface = insertion.needle(deepest), scene.tissue.surface
    # It may come from outside a phantom that is smaller than the scenario's.
    if whole and not surface.contains(whole.position(np.arange(0, whole.length, 1e-3))).any():
        check_entry(scenario, surface)
    time = deepest if time is None else time
    require_not_negative(time=time)
    geometry, station = scene.geometry, scenario.station
    middle = geometry.frames // 2
    times = geometry.frame_times(time, since=middle)
    breathing = scenario.phantom_motion.breathing
    X_WT = RigidTransform(breathing.displacement(time)) @ station.X_WT
    if X_TP is None:
        needle = insertion.needle(time)
        x, y = needle.tip[:2] if needle else (None, None)
        pose = station.probe_pose(x=x, y=y, height=-_INDENTATION, surface=scene.tissue.surface)
        X_TP = station.X_WT.InvertAndCompose(pose)
    poses = np.tile(np.eye(4), (geometry.frames, 1, 1))
    poses[:, :3, 3] = (times - time)[:, np.newaxis] * np.array(velocity)
    poses = X_TP.GetAsMatrix4() @ poses
    motion = SweepMotion(geometry, 1, times, X_WT.GetAsMatrix4() @ poses)
    away = [breathing.displacement(float(each)) for each in times]
    poses[:, :3, 3] += breathing.displacement(time) - np.array(away)
    acquired = scene.acquire(motion, poses)
    parameters = scenario.scan_conversion
    conversion = ScanConversion(
        geometry,
        make_grid(geometry, parameters.spacing),
        compensate_motion=parameters.compensate_motion,
    )
    return Scan(
        acquired.sweep,
        conversion(acquired.sweep),
        acquired.needles[middle].transformed(X_WT),
        caption=_caption(geometry, scenario),
    )


def write_scan(scan: Scan, out: Path) -> list[Path]:
    """Write scan.png, a sheet of pictures, and scan.nrrd, the volume; return their paths."""
    return [
        write_atomically(out / "scan.png", png(scan.plot())),
        write_volume(out / "scan.nrrd", scan.volume),
    ]


def _caption(geometry: SweepGeometry, scenario: FollowingScenario) -> str:
    imaging = scenario.imaging
    return (
        f"{Path(scenario.probe).stem} at {1e-6 * imaging.transmit_frequency:.1f} MHz:  "
        f"{imaging.volume_rate:g} volumes/s,  {geometry.frames} frames x {geometry.lines} lines x "
        f"{geometry.samples} samples,  {1e3 * geometry.depth:.0f} mm deep"
    )


def summarize_scan(scan: Scan, scenario: FollowingScenario) -> dict[str, Any]:
    """Return the figures to print: settings, voxels and needle."""
    geometry = scan.sweep.geometry
    needle = scan.needle
    return {
        "scenario": scenario.name,
        "seed": scenario.seed,
        "time_s": scan.volume.time,
        "transducer": scenario.probe,
        "volume_rate_hz": scenario.imaging.volume_rate,
        "frames_lines_samples": list(geometry.shape),
        "voxels": list(scan.volume.intensities.shape),
        "spacing_mm": [1e3 * float(s) for s in scan.volume.spacing],
        "inserted_mm": 1e3 * needle.length if needle else 0.0,
        "tip_in_probe_mm": (
            (1e3 * scan.volume.to_probe(needle.tip[np.newaxis])[0]).tolist() if needle else None
        ),
    }
