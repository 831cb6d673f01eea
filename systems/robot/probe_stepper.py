"""Leaf system that steps a probe along its own Z axis."""

import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.systems.framework import Context, LeafSystem

from sonoservo.systems.signals.ports import declare_output
from sonoservo.systems.signals.requirements import require, require_not_negative, require_positive


class ProbeStepper(LeafSystem):
    """Steps a probe along its own Z axis from slice to slice, as a function of time alone.

    .. pydrake_system::

        name: ProbeStepper
        output_ports:
        - X_WP
        - X_WT

    ``X_WP`` is the pose of the probe. ``X_WT`` is the pose of the tissue, which moves slightly
    because the probe drags it along and the patient breathes. At every step it is shifted across
    the insertion by an unknown random amount. Breathing adds a shift along one direction across the
    insertion, with the square of a sine over time (Lujan et al. 1999) from zero to the amplitude.

    Parameters
    ----------
    X_WP
        Pose at the first slice.
    step
        Distance between slices, in m.
    period
        Time between steps, in s. The first step is at time ``period``.
    steps
        Number of steps, after which the probe rests.
    tissue_shift
        Standard deviation of the tissue's shift along X and along Y of P, in m.
    breathing, breathing_period
        Amplitude in m and period in s of the shift by breathing.
    seed
        Seed of the shifts, and of the direction and phase of the breathing.
    """

    def __init__(
        self,
        *,
        X_WP: RigidTransform,
        step: float,
        period: float,
        steps: int,
        tissue_shift: float = 0.0,
        breathing: float = 0.0,
        breathing_period: float = 4.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        self.set_name("probe_stepper")
        require_positive(step=step, period=period, breathing_period=breathing_period)
        require_not_negative(tissue_shift=tissue_shift, breathing=breathing)
        require(steps >= 1, "steps", steps, "at least 1")
        self._X_WP, self._step, self._period, self._steps = X_WP, step, period, steps
        rng = np.random.default_rng(seed)
        self._shifts = tissue_shift * rng.normal(size=(steps + 1, 2))
        if breathing:
            direction, phase = rng.uniform(0, 2 * np.pi), rng.uniform(0, np.pi)
            turns = np.pi * period * np.arange(steps + 1) / breathing_period
            along = np.array([np.cos(direction), np.sin(direction)])
            self._shifts += np.outer(breathing * np.sin(turns + phase) ** 2, along)
        for name, calc in (("X_WP", self._calc_probe), ("X_WT", self._calc_tissue)):
            declare_output(self, name, RigidTransform, calc, {self.time_ticket()})

    def _number(self, context: Context) -> int:
        """Return the number of the slice that is due."""
        # An event's time may be a rounding error early.
        return min(int(context.get_time() / self._period + 1e-6), self._steps)

    def _calc_probe(self, context: Context, output: Value) -> None:
        moved = RigidTransform([0.0, 0.0, self._number(context) * self._step])
        output.set_value(self._X_WP @ moved)

    def _calc_tissue(self, context: Context, output: Value) -> None:
        shift = np.append(self._shifts[self._number(context)], 0.0)
        output.set_value(RigidTransform(self._X_WP.rotation() @ shift))
