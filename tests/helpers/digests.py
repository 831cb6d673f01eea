"""Digests of the volumes and estimates of two short runs, on the processor that Numba is told.

The needle of the first is found and followed; the second has tissue and errors of every kind.
"""

import hashlib
import json
import sys

import numpy as np

from sonoservo.diagrams import FollowingExperiment, load_scenario

SMALL = {"imaging.depth": 0.075, "imaging.frame_pitch_deg": 2.0, "hand.start": 1.0}
SCENARIOS = {"chatelain2013_fig5": SMALL | {"hand.entry": [-0.10, 0.0, -0.042]}, "clinic": SMALL}


def digest(*values):
    """Return a digest of arrays and texts."""
    made = hashlib.sha256()
    for value in values:
        made.update(value.encode() if isinstance(value, str) else np.asarray(value).tobytes())
    return made.hexdigest()[:16]


def digests(name, changes, volumes):
    """Return digests of a run's first volumes and of their estimates, and each estimate's mode."""
    experiment = FollowingExperiment(load_scenario(name, changes=changes, seed=100))
    made = []

    def note(experiment):
        volume = experiment.evaluate(experiment.scan_converter, "volume")
        estimate = experiment.estimate
        values = [str(estimate.mode), estimate.reason]
        if estimate:
            values += [estimate.curve.control_points, estimate.velocity, estimate.covariance]
        made.append([digest(volume.intensities), digest(*values), str(estimate.mode)])

    experiment.start()
    while len(made) < volumes:
        experiment.advance(experiment.time + 0.5, note)
    return made[:volumes]


if __name__ == "__main__":
    print(json.dumps({k: digests(k, v, int(sys.argv[1])) for k, v in SCENARIOS.items()}))
