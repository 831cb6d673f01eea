"""Volumes of the project's own scanner: kinds of needles, bodies, settings and structures."""

import tempfile
from pathlib import Path

import numpy as np
import yaml
from random_scans import random_scan

from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import read_yaml

NEEDLES = ("biopsy", "brachytherapy", "coated", "echogenic", "spinal")
PHANTOMS = ("agar", "liver", "prostate", "limb")
"""Phantoms without a wire and without a needle at rest, which look like needles."""


def drawn_structures(rng):
    """Two to six structures around the middle of the phantom, near the surface or deep."""

    def place():
        return [float(x) for x in rng.uniform([-0.06, -0.03, -0.07], [0.03, 0.03, -0.015])]

    def ends(length):
        away = rng.normal(size=3) * [1, 1, 0.3]
        away *= length / np.linalg.norm(away)
        start = np.array(place())
        return start.tolist(), [*(start + away)[:2].tolist(), float(min(start[2] + away[2], -8e-3))]

    made = []
    for kind in rng.choice(["fascia", "fascia", "vessel", "bone", "gas", "calcification"],
                           rng.integers(2, 7)):  # fmt: skip
        level = float(rng.uniform(0.7, 1.0))
        if kind == "fascia":
            made.append({"kind": "fascia", "centre": place(), "level_db": 30 * level,
                         "size": rng.uniform(0.03, 0.09, 2).tolist(),
                         "azimuth_deg": float(rng.uniform(0, 360)),
                         "dip_deg": float(rng.uniform(0, 30))})  # fmt: skip
        elif kind == "vessel":
            made.append({"kind": "vessel", "path": list(ends(0.08)), "level_db": 38 * level,
                         "radius": float(rng.uniform(1e-3, 5e-3))})  # fmt: skip
        elif kind == "bone":
            start, end = ends(0.06)
            made.append({"kind": "bone", "start": start, "end": end, "level_db": 46 * level,
                         "width": float(rng.uniform(6e-3, 14e-3))})  # fmt: skip
        elif kind == "gas":
            made.append({"kind": "gas", "centre": place(), "level_db": 45 * level,
                         "size": rng.uniform(4e-3, 20e-3, 2).tolist()})  # fmt: skip
        else:
            made.append({"kind": "calcification", "centre": place(), "level_db": 36 * level,
                         "radius": float(rng.uniform(0.5e-3, 3e-3))})  # fmt: skip
    return made


def drawn_scan(seed, needle):
    """Return a `RandomScan`, half of them with structures; None if one of these is a vessel.

    The wall of a straight vessel mirrors along a line, so it looks like a wire.
    """
    rng = np.random.default_rng([seed, 11])
    with tempfile.TemporaryDirectory() as folder:
        return _drawn_scan(seed, needle, rng, Path(folder))


def _drawn_scan(seed, needle, rng, folder):
    changes = {
        "needle": str(rng.choice(NEEDLES)),
        "scanner.needle.fading_db": float(rng.choice([0.0, 3.0, 6.0])),
        "scanner.air_pockets.share": float(rng.choice([0.0, 0.0, 0.1])),
        "imaging.gain": float(rng.uniform(0.35, 0.5)),
        "imaging.focus_depth": float(rng.uniform(0.02, 0.06)),
        "imaging.transmit_frequency": float(rng.uniform(3.0e6, 4.5e6)),
        "imaging.dynamic_range_db": float(rng.uniform(50, 70)),
    }
    if rng.random() < 0.5:
        fat = float(rng.choice([0.0, 4e-3]))
        structures = drawn_structures(rng)
        if any(each["kind"] == "vessel" for each in structures):
            return None
        tissue = {"size": [0.24, 0.16, 0.08], "scatterers_per_cell": 4, "attenuation": 0.5,
                  "fat": {"thickness": fat}, "structures": structures}  # fmt: skip
        path = folder / "body.yaml"
        path.write_text(yaml.safe_dump({"tissue": tissue}))
        changes["phantom"] = str(path)
    else:
        changes["phantom"] = str(rng.choice(PHANTOMS))
    if rng.random() < 0.3:  # a lens that draws out what is far from its focus
        probe = read_yaml(model_file("probes", "4dc7_3_40"))
        probe["transducer"]["lens_focus"] = float(rng.uniform(0.015, 0.08))
        path = folder / "probe.yaml"
        path.write_text(yaml.safe_dump(probe))
        changes["probe"] = str(path)
    return random_scan(seed, needle, changes, steepest=45)
