"""Contrast along the needle of the papers' figures, in dB over tissue and over agar's speckle.

The probe lies as at rest at the end of a run: over the tip, along the needle's mean direction.
"""

from argparse import ArgumentParser
from itertools import pairwise

import numpy as np
from needle_echo import measure_needle_echo

from sonoservo.diagrams import load_scenario, scan

FIGURES = ("fig4", "fig5", "fig6")
SEEDS = range(100, 106)
EDGES = [0, 2, 5, 10, 20, 30]
AGAR = -12.0


def contrasts(figure, seeds=SEEDS):
    """Return (seeds, bins) levels over tissue in dB; bins lie between `EDGES`, from the tip."""
    rows = []
    for seed in seeds:
        changes = ["station.probe.yaw_deg=0"]
        scenario = load_scenario(f"chatelain2013_{figure}", changes=changes, seed=seed)
        shown = scan(scenario)
        shaft = shown.volume.to_probe(shown.needle.shaft)
        echo = measure_needle_echo(shown.sweep, shaft, scenario.imaging)
        behind = 1e3 * (echo.distance[-1] - echo.distance)
        bins = np.digitize(behind, EDGES) - 1
        rows.append([np.nanmean(echo.level_db[bins == n]) for n in range(len(EDGES) - 1)])
    return np.array(rows)


def main():
    """Print a table of the median, smallest and largest contrast of the seeds."""
    pairs = pairwise(EDGES)
    print("| | " + " | ".join(f"{a} to {b} mm" for a, b in pairs) + " |")
    print("|---|" + "---|" * (len(EDGES) - 1))
    for figure in FIGURES:
        levels = contrasts(figure)
        for over, name in ((0.0, "tissue"), (AGAR, "agar")):
            cells = [
                f"{np.median(each) - over:.0f} ({each.min() - over:.0f} to {each.max() - over:.0f})"
                for each in levels.T
            ]
            print(f"| {figure}, over {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    ArgumentParser(description=__doc__).parse_args()
    main()
