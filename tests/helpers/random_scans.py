"""Single volumes of the agar phantom, with a needle that comes in from the side or without one."""

from dataclasses import dataclass

import numpy as np
from pydrake.math import RigidTransform

from sonoservo.diagrams import load_scenario, scan
from sonoservo.systems.signals import NeedleCurve, Volume
from sonoservo.systems.ultrasound import load_transducer, sweep_geometry

OUTSIDE = 15e-3
"""Length of needle in the tissue before it enters the field of view, in m."""


@dataclass
class RandomScan:
    volume: Volume
    needle: NeedleCurve | None  # the part in the field of view, in W


def random_scan(seed, needle=True, changes=(), steepest=30):
    """A needle of 20 to 80 mm in view, 0 to 30 deg to the probe's face; balls and fibres."""
    rng = np.random.default_rng([seed, 7])
    scenario = load_scenario("chatelain2013_fig5", seed=seed, changes=changes)
    geometry = sweep_geometry(load_transducer(scenario.probe), scenario.imaging)
    side = rng.choice([0, geometry.lines - 1])
    inwards = 1 if side == 0 else -1
    while True:
        frame = geometry.frames // 2 + rng.uniform(-4, 4)
        p_PSide = geometry.position(
            frame, side, rng.uniform(15e-3, 65e-3) / geometry.sample_pitch, 1
        )
        dip, turn = np.deg2rad(rng.uniform(0, steepest)), np.deg2rad(rng.uniform(-15, 15))
        k = np.array(
            [inwards * np.cos(dip) * np.cos(turn), np.sin(dip), np.cos(dip) * np.sin(turn)]
        )
        length = rng.uniform(20e-3, 80e-3)
        if geometry.contains(p_PSide + np.outer([0.1 * length, length, length + 2e-3], k)).all():
            break
    station = scenario.station
    X_TP = station.X_WT.InvertAndCompose(
        station.probe_pose(
            x=rng.uniform(-0.06, 0.03), y=rng.uniform(-0.01, 0.01),
            yaw_deg=rng.uniform(-90, 90), height=-4e-3,
        )
    )  # fmt: skip
    entry, direction = X_TP.multiply(p_PSide - OUTSIDE * k), X_TP.rotation().multiply(k)
    hand = scenario.hand
    hand.entry, hand.entry_spread, hand.angle_spread_deg = list(entry), [0.0] * 3, 0.0
    hand.azimuth_deg = float(np.rad2deg(np.arctan2(direction[1], direction[0])))
    hand.dip_deg = float(np.rad2deg(-np.arcsin(direction[2])))
    hand.pushes = [type(hand.pushes[0])(duration=10.0, speed=(length + OUTSIDE) / 10)]
    made = scan(scenario, time=25.0 if needle else 0.0, X_TP=RigidTransform(X_TP))
    if not needle:
        return RandomScan(made.volume, None)
    ends = made.needle.shaft[[0, -1]]
    k = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    return RandomScan(made.volume, NeedleCurve([ends[0] + OUTSIDE * k, ends[1]]))
