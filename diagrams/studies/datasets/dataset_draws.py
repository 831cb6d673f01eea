"""Random draws of a data set: scanner, tissue, pose of the probe, and needle."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydrake.math import RigidTransform

from sonoservo.diagrams.assembly import load_dome_radius
from sonoservo.diagrams.dials import draw_dials_on
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.scene import Scene
from sonoservo.systems.needle.insertion import Insertion
from sonoservo.systems.needle.insertion_parameters import InsertionParameters, Push
from sonoservo.systems.signals.sweep import SweepGeometry
from sonoservo.systems.ultrasound.imaging import ImagingParameters, sweep_geometry
from sonoservo.systems.ultrasound.simulation.scanner_parameters import ScannerParameters
from sonoservo.systems.ultrasound.simulation.tissue import Ball, Fibre, Tissue, load_tissue
from sonoservo.systems.ultrasound.transducer import Transducer, load_transducer

_SEEN = (
    "phantom",
    "phantom_motion.",
    "scanner.air_pockets.",
    "scanner.motor.",
    "scanner.needle.",
    "tissue_reaction.",
)
"""Beginnings of the fields that show in the volumes of a probe held still."""

_DIP, _SPEED = "hand.dip_deg", "hand.pushes.0.speed"


@dataclass(frozen=True)
class DrawnDials:
    """Dials of one sequence."""

    strengths: Mapping[str, float] = field(default_factory=dict)  # relative to the moderate ones
    changes: tuple[str, ...] = ()
    max_dip_deg: float = 30.0  # of the needle, below the horizontal
    max_speed: float = 12e-3  # of the needle, in m/s


def draw_dials(rng: np.random.Generator) -> DrawnDials:
    """Draw which dials that show in a volume are on, and how far."""
    strengths: dict[str, float] = {}
    changes: list[str] = []
    taken: set[str] = set()
    limits = {_DIP: DrawnDials.max_dip_deg, _SPEED: DrawnDials.max_speed}
    for name, dial, strength in draw_dials_on(rng):
        raised = [path for path in dial.moderate if path in limits]
        if taken & dial.moderate.keys():
            continue
        if raised:
            for path in raised:
                limits[path] = max(limits[path], strength * dial.moderate[path])
        elif all(path.startswith(_SEEN) for path in dial.moderate):
            taken |= dial.moderate.keys()
            changes += dial.changes(strength)
        else:
            continue
        strengths[name] = strength
    return DrawnDials(strengths, tuple(changes), limits[_DIP], limits[_SPEED])


_OUTSIDE = 15e-3  # length of needle in the tissue before it enters the field of view, in m
_INDENTATION = 4e-3  # indentation of the phantom by the probe, in m


@dataclass(frozen=True)
class DrawnScanner:
    """Scanner and tissue of a sequence, with structures where the tissue's file puts them."""

    name: str
    transducer: Transducer
    imaging: ImagingParameters
    tissue: Tissue
    parameters: ScannerParameters
    seed: int

    @cached_property
    def geometry(self) -> SweepGeometry:
        """Geometry of the sweeps."""
        return sweep_geometry(self.transducer, self.imaging)

    @property
    def acoustic_geometry(self) -> SweepGeometry:
        """Geometry of the samples as they lie in tissue with another speed of sound."""
        speed = self.tissue.sound_speed or self.imaging.sound_speed
        pitch = self.geometry.sample_pitch * (speed / self.imaging.sound_speed)
        return replace(self.geometry, sample_pitch=pitch, sound_speed=speed)

    def scene(self, insertion: Insertion, scenario: FollowingScenario) -> Scene:
        """Return the scene, with the structures beside a needle's path and the reaction."""
        reaction = scenario.tissue_reaction
        return Scene(
            transducer=self.transducer,
            imaging=self.imaging,
            tissue=self.tissue.placed(insertion.entry, insertion.direction, self.seed),
            parameters=self.parameters,
            insertion=insertion,
            seed=self.seed,
            reaction=reaction,
            dome_radius=load_dome_radius(scenario.probe) if reaction.acts else 0.0,
        )

    def labels(self) -> dict[str, Any]:
        """Return what was drawn, for the labels."""
        return {
            "transducer": {"name": self.name, **asdict(self.transducer)},
            "imaging": asdict(self.imaging),
            "tissue": asdict(self.tissue),
        }


def draw_scanner(
    scenario: FollowingScenario, transducers: list[str], rng: np.random.Generator
) -> DrawnScanner:
    """Draw the transducer, the scanner's settings and the tissue."""
    name = transducers[rng.integers(len(transducers))]
    transducer = load_transducer(name)
    # Properties that manufacturers do not publish.
    transducer = replace(
        transducer,
        element_height=transducer.element_height * rng.uniform(0.8, 1.2),
        lens_focus=transducer.lens_focus * rng.uniform(0.8, 1.25),
        fractional_bandwidth=rng.uniform(0.5, 0.8),
    )
    low, high = transducer.lowest_frequency, transducer.highest_frequency
    imaging = replace(
        scenario.imaging,
        gain=rng.uniform(0.34, 0.5),
        transmit_frequency=rng.uniform(low, min(high, 1.3 * low)),
        focus_depth=rng.uniform(0.025, 0.06),
    )
    tissue = _draw_tissue(load_tissue(scenario.phantom), rng)
    seed = int(rng.integers(1 << 31))
    return DrawnScanner(name, transducer, imaging, tissue, scenario.scanner, seed)


def _draw_tissue(tissue: Tissue, rng: np.random.Generator) -> Tissue:
    """Draw speckle, attenuation and bright inclusions."""
    half = 0.5 * np.array(tissue.size) * [1, 1, 0]
    low, high = -half - [0, 0, tissue.size[2]], half

    def point() -> NDArray[np.float64]:
        return rng.uniform(0.95 * low, 0.95 * high - [0, 0, 0.015])

    fibres = []
    for _ in range(rng.integers(3, 9)):
        start = point()
        step = rng.normal(size=3) * [1, 1, 0.2]
        end = start + rng.uniform(5e-3, 15e-3) * step / np.linalg.norm(step)
        fibres.append(
            Fibre(start=start.tolist(), end=np.clip(end, low, high).tolist(), level_db=34.0)
        )
    return replace(
        tissue,
        scatterers_per_cell=rng.uniform(2, 8),
        attenuation=rng.uniform(0.3, 0.7),
        balls=[
            Ball(
                centre=point().tolist(),
                radius=rng.uniform(0.8e-3, 1.8e-3),
                level_db=rng.uniform(24, 32),
            )
            for _ in range(rng.integers(6, 16))
        ],
        fibres=fibres,
        seed=int(rng.integers(1 << 31)),
    )


def draw_insertion(
    scenario: FollowingScenario,
    geometry: SweepGeometry,
    volumes: int,
    rng: np.random.Generator,
    dials: DrawnDials,
) -> tuple[RigidTransform, InsertionParameters]:
    """Draw the pose of the probe, and a needle that enters its view from the side."""
    station = scenario.station
    X_TP = station.X_WT.InvertAndCompose(
        station.probe_pose(
            x=rng.uniform(-0.05, 0.05),
            y=rng.uniform(-0.01, 0.01),
            yaw_deg=rng.uniform(-90, 90),
            height=-_INDENTATION,
            surface=load_tissue(scenario.phantom).surface,
        )
    )
    side = rng.choice([0, geometry.lines - 1])
    while True:
        frame = (geometry.frames - 1) * rng.uniform(0.35, 0.65)
        depth = geometry.depth * rng.uniform(0.2, 0.7)
        p_PSide = geometry.position(frame, side, depth / geometry.sample_pitch, 1)
        dip, turn = np.deg2rad([rng.uniform(0, dials.max_dip_deg), rng.uniform(-15, 15)])
        inwards = 1 if side == 0 else -1
        k = np.array(
            [inwards * np.cos(turn) * np.cos(dip), np.sin(dip), np.cos(dip) * np.sin(turn)]
        )
        length = rng.uniform(10e-3, 80e-3)
        if geometry.contains(p_PSide + np.outer([0.1 * length, length], k)).all():
            break
    entry, direction = X_TP.multiply(p_PSide - _OUTSIDE * k), X_TP.rotation() @ k
    duration = (volumes + 1) * geometry.period
    speed = min(length / duration, rng.uniform(2e-3, dials.max_speed))
    # The first push inserts the length that is not inserted during the volumes.
    before = _OUTSIDE + length - speed * duration
    return X_TP, replace(
        scenario.hand,
        gauge=int(rng.choice([17, 18, 20])),
        entry=entry.tolist(),
        aim=None,
        initial_depth=None,
        entry_spread=[0.0, 0.0, 0.0],
        angle_spread_deg=0.0,
        azimuth_deg=float(np.rad2deg(np.arctan2(direction[1], direction[0]))),
        dip_deg=float(np.rad2deg(-np.arcsin(direction[2]))),
        bend_radius=float(rng.uniform(0.2, 0.6)) if rng.random() < 0.3 else None,
        bend_roll_deg=float(rng.uniform(-180, 180)),
        start=0.0,
        pushes=[Push(duration=1.0, speed=before), Push(duration=duration, speed=speed)],
        ramp=0.1,
    )
