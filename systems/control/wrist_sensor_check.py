"""Plausibility of the wrist force sensor's samples, one sample at a time."""

import math
from enum import IntEnum
from typing import NamedTuple

from sonoservo.systems.control.guard_parameters import WristSensorLimits

_NAN = math.nan
_ROUNDING = 1e-9
"""Rounding error of times, in s."""

_STEADY = 0.25
"""Share of the largest step by which a steady force may change between two samples."""

_ZERO = 0.2
"""Share of a dead sensor's largest noise below which the mean of its readings is zero."""


class SensorFault(IntEnum):
    """Faults of the wrist sensor."""

    NONE = 0
    NOT_FINITE = 1
    OUT_OF_RANGE = 2
    FROZEN = 3
    JUMPED = 4
    PULLING = 5
    DEAD = 6


class SensorMemory(NamedTuple):
    """What must be remembered of earlier samples; all numbers.

    Parameters
    ----------
    last
        (6,) last sample: torque in N m, then force in N.
    trusted
        (3,) last plausible force, in N; NaN until the sensor has started, which is when a sample
        first differs from the one before.
    steady
        Whether the last plausible sample was close to the one before.
    jump
        Largest difference from that sample while samples are implausible, in N.
    ignored, ignored_as
        Number of implausible samples that were no confirmed fault, and the fault that the last of
        them suggested.
    changed
        Time at which the sample last changed, in s.
    suspicion, suspected
        Fault that the last sample suggests, and the time in s since which samples suggest one
        again and again.
    cleared
        Last time at which a sample was implausible, in s.
    fault
        Confirmed fault.
    felt, total, readings
        Last time in s at which the sensor read more than noise, and sum in N and number of its
        readings along the probe's axis since then.
    """

    last: tuple[float, ...] = 6 * (_NAN,)
    trusted: tuple[float, ...] = 3 * (_NAN,)
    steady: int = True
    jump: float = 0.0
    ignored: int = 0
    ignored_as: int = SensorFault.NONE
    changed: float = 0.0
    suspicion: int = SensorFault.NONE
    suspected: float = 0.0
    cleared: float = -math.inf
    fault: int = SensorFault.NONE
    felt: float = 0.0
    total: float = 0.0
    readings: int = 0

    @property
    def started(self) -> bool:
        """True once the sensor has delivered two different samples."""
        return self.trusted[0] == self.trusted[0]


def next_memory(
    memory: SensorMemory,
    sample: tuple[float, ...],
    pressing: float,
    time: float,
    limits: WristSensorLimits,
    *,
    moving: bool = False,
) -> SensorMemory:
    """Return the memory after one more sample.

    Parameters
    ----------
    memory
        Memory before the sample.
    sample
        (6,) torque in N m, then force in N.
    pressing
        Force with which the probe presses according to the sample, in N; negative if it pulls.
    time
        Time of the sample, in s.
    limits
        Limits of plausible samples.
    moving
        Whether the guard accelerates the probe, whose inertia then pulls and pushes.
    """
    same = sample == memory.last
    changed = memory.changed if same else time
    force = sample[3:]
    felt, total, readings = time, 0.0, 0
    if _reads_nothing(sample, limits):
        felt, total, readings = memory.felt, memory.total + sample[4], int(memory.readings) + 1
    silent = time - felt if abs(total) < _ZERO * limits.dead_below * readings else 0.0
    suspicion = _suspicion(memory, sample, pressing, time - changed, silent, limits, moving)
    if suspicion == SensorFault.NONE:
        started = memory.started or (memory.last[0] == memory.last[0] and not same)
        settled = time - memory.cleared >= limits.settling_time - _ROUNDING
        return SensorMemory(
            sample,
            force if started else memory.trusted,
            not _change(force, memory.trusted) > _STEADY * limits.max_step,
            0.0,
            memory.ignored,
            memory.ignored_as,
            changed,
            suspicion,
            memory.suspected,
            memory.cleared,
            SensorFault.NONE if settled else memory.fault,
            felt,
            total,
            readings,
        )
    # Good samples in between do not count, if implausible ones keep coming.
    again = memory.suspicion or time - memory.cleared < limits.confirmed_after
    since = memory.suspected if again else time
    late = time - since >= limits.confirmed_after - _ROUNDING
    confirmed = late or memory.fault or suspicion in (SensorFault.FROZEN, SensorFault.DEAD)
    # After a jump that lasts, further samples are compared with the new level.
    trusted = force if suspicion == SensorFault.JUMPED and confirmed else memory.trusted
    fault = suspicion if confirmed else SensorFault.NONE
    ignored, ignored_as = memory.ignored, memory.ignored_as
    if not confirmed:
        ignored, ignored_as = int(ignored) + 1, suspicion
    jump = max(memory.jump, _change(force, memory.trusted))
    return SensorMemory(
        sample, trusted, True, jump, ignored, ignored_as, changed, suspicion, since, time, fault,
        felt, total, readings,
    )  # fmt: skip


def _suspicion(
    memory: SensorMemory,
    sample: tuple[float, ...],
    pressing: float,
    unchanged: float,
    silent: float,
    limits: WristSensorLimits,
    moving: bool,
) -> int:
    """Return the fault that a sample suggests.

    It has been unchanged, and the sensor has read nothing, for times in s.
    """
    if not math.isfinite(sum(sample)):
        return SensorFault.NOT_FINITE
    m_x, m_y, m_z, f_x, f_y, f_z = sample
    top, torque = limits.max_force, limits.max_torque
    if not (
        -top < f_x < top
        and -top < f_y < top
        and -top < f_z < top
        and -torque < m_x < torque
        and -torque < m_y < torque
        and -torque < m_z < torque
    ):
        return SensorFault.OUT_OF_RANGE
    if limits.frozen_after and unchanged > limits.frozen_after:
        return SensorFault.FROZEN
    if limits.dead_after and silent > limits.dead_after:
        return SensorFault.DEAD
    if not memory.started:
        return SensorFault.NONE
    if not moving and _is_jump(memory, sample, limits):
        return SensorFault.JUMPED
    if pressing < -limits.max_pull and not moving:
        return SensorFault.PULLING
    stays = memory.fault == SensorFault.JUMPED and pressing > limits.max_pull
    return SensorFault.JUMPED if stays else SensorFault.NONE


def _is_jump(memory: SensorMemory, sample: tuple[float, ...], limits: WristSensorLimits) -> bool:
    """Return True if a force differs from the trusted one as that of no contact does."""
    change = _change(sample[3:], memory.trusted)
    if change > limits.max_jump:
        return True
    # A step, even a small one, after which the sensor reads nothing is its death.
    dead = _reads_nothing(sample, limits)
    step = _STEADY * limits.max_step if dead else limits.max_step
    if memory.suspicion == SensorFault.JUMPED and not memory.fault:
        # A contact that has begun so fast goes on growing.
        return 0.5 * step < change < memory.jump + _STEADY * limits.max_step
    # After samples that were implausible in another way, there is nothing to compare with.
    comparable = memory.suspicion == SensorFault.NONE and (memory.steady or memory.fault)
    return bool(comparable) and change > step


def _reads_nothing(sample: tuple[float, ...], limits: WristSensorLimits) -> bool:
    """Return True if all components of a (6,) sample are zero but for noise."""
    noise = limits.dead_below
    m_x, m_y, m_z, f_x, f_y, f_z = sample
    return (
        -noise < f_y < noise
        and -noise < f_x < noise
        and -noise < f_z < noise
        and -noise < m_x < noise
        and -noise < m_y < noise
        and -noise < m_z < noise
    )


def _change(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    """Return the largest difference of the components of two (3,) forces in N."""
    return max(abs(a[0] - b[0]), abs(a[1] - b[1]), abs(a[2] - b[2]))
