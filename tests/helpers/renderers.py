"""A renderer in a tissue large enough for its whole sweep, and poses of its frames."""

from dataclasses import replace

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import LeafSystem

from sonoservo.systems.signals import Needle
from sonoservo.systems.ultrasound import ImagingParameters, Transducer
from sonoservo.systems.ultrasound.simulation import (
    NeedleEchoParameters,
    ScannerParameters,
    SweepRenderer,
    Tissue,
)

CLEAN = ScannerParameters(noise_db=-55, gain_error_db=0, clutter_db=-300, decorrelation=0)
"""A scanner whose image shows nothing but the tissue and what is in it."""
NOWHERE = Needle(np.zeros((0, 3)), 0.635e-3)
DEEP = Tissue(size=[0.6, 0.6, 0.4])
"""Large enough to hold the whole sweep wherever the probe is."""


class World(LeafSystem):
    """Poses and needles as functions of time, by the names of its ports."""

    def __init__(self, **functions):
        super().__init__()
        for name, function in functions.items():
            model = Value[object]() if "needle" in name else Value(RigidTransform())
            self.DeclareAbstractOutputPort(
                name, model.Clone, lambda c, output, f=function: output.set_value(f(c.get_time()))
            )


def make_renderer(tissue=DEEP, needle=None, transducer=None, track_db=-300.0, **imaging):
    settings = {"depth": 0.09, "focus_depth": 0.06, "volume_rate": 2.0, "frames": 27}
    return SweepRenderer(
        transducer=transducer or Transducer(),
        imaging=ImagingParameters(**settings | imaging),
        tissue=tissue,
        parameters=replace(CLEAN, needle=needle or NeedleEchoParameters(), track_db=track_db),
        seed=0,
    )


def about(axis, angle, point):
    """Pose (4, 4) of a rotation about an axis through a point."""
    X = np.eye(4)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    X[i, i] = X[j, j] = np.cos(angle)
    X[i, j], X[j, i] = -np.sin(angle), np.sin(angle)
    X[:3, 3] = np.array(point) - X[:3, :3] @ point
    return X


def shift(*xyz):
    X = np.eye(4)
    X[:3, 3] = xyz
    return X


# The probe looks down: X_P along X_T, depth Y_P along -Z_T; its face 100 mm below the top.
DOWN = np.array([[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, -0.1], [0, 0, 0, 1.0]])


def still(renderer, X=DOWN):
    return np.repeat(X[np.newaxis], renderer.geometry.frames, axis=0)


def upright(renderer, motion, places):
    """Poses for which every frame's plane is upright, at places of its own, moved in that plane."""
    geometry = renderer.geometry
    axis = [0, -geometry.motor_radius, 0]
    poses = []
    for theta, place in zip(geometry.line_angles(1).mean(axis=1), places, strict=True):
        poses.append(DOWN @ shift(*place) @ motion @ about(0, -theta, axis))
    return np.array(poses)


def correlation(a, b):
    return abs(np.vdot(a, b)) / np.sqrt(np.vdot(a, a).real * np.vdot(b, b).real)


def needle_through(point, azimuth, rise, half_length=0.04):
    """A needle through a point of T, with its middle there; angles in rad."""
    direction = np.array(
        [np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)]
    )
    return Needle(np.array(point) + np.outer([-half_length, half_length], direction), 0.635e-3)
