"""Echoes of points by PyMUST, an independent simulator of ultrasound transducers."""

import numpy as np
import pymust
from scipy.signal import hilbert


def middle_line(transducer, imaging, points, amplitudes, focus):
    """Envelope of the echo along the line through the middle of a convex or flat array.

    Parameters
    ----------
    transducer, imaging
        Whose elements, apertures, focus and pulse.
    points
        (n, 3) lateral offset, depth below the apex and elevation offset, in m.
    amplitudes
        (n,) of the points.
    focus
        Depth in m at which the receiving aperture is chosen and focused.
    """
    arc = (np.arange(transducer.elements) - (transducer.elements - 1) / 2) * (
        transducer.element_pitch
    )
    x, y = arc, np.zeros(len(arc))
    if transducer.array_radius > 0:
        x = transducer.array_radius * np.sin(arc / transducer.array_radius)
        y = transducer.array_radius * (np.cos(arc / transducer.array_radius) - 1)  # apex at zero
    p = pymust.utils.Param()
    p.fc = imaging.transmit_frequency
    p.bandwidth = 100 * transducer.fractional_bandwidth
    p.Nelements = transducer.elements
    p.pitch = transducer.element_pitch
    p.kerf = transducer.element_pitch - transducer.element_width
    p.radius = transducer.array_radius or np.inf
    p.height = transducer.element_height
    p.focus = transducer.lens_focus
    p.c = imaging.sound_speed
    p.fs = 10 * p.fc
    widest = transducer.transmit_elements * transducer.element_pitch
    sending = np.abs(arc) <= min(widest, imaging.focus_depth / transducer.transmit_f_number) / 2
    delays = -np.hypot(x, imaging.focus_depth - y) / p.c
    delays = np.where(sending, delays - delays[sending].min(), np.nan)
    p.TXapodization = sending.astype(float)
    aperture = min(
        focus / transducer.receive_f_number, transducer.receive_elements * transducer.element_pitch
    )
    window = np.where(np.abs(arc) < aperture / 2, np.cos(np.pi * arc / aperture) ** 2, 0)
    lateral, depth, elevation = np.transpose(points)
    echoes, _ = pymust.simus(
        lateral,
        np.maximum(elevation, 1e-8),  # at zero, PyMUST would leave the elevation out
        depth - y.min(),  # PyMUST counts depth from the array's chord
        np.asarray(amplitudes, float),
        delays[np.newaxis],
        p,
    )
    time = np.arange(len(echoes)) / p.fs
    line = np.zeros(len(time))
    for element in np.flatnonzero(window):
        delay = np.hypot(x[element], focus - y[element]) / p.c
        line += window[element] * np.interp(time + delay, time, echoes[:, element], right=0)
    return np.abs(hilbert(line))
