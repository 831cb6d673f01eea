"""Command that makes the volumes, fits the weights, and prints them with their score."""

import argparse

import numpy as np

from .fit import fit, probabilities, score
from .lines import GENERATORS, collect


def main(arguments=None):
    """Fit on two of three seeds, print the weights and their score on the third."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--seeds", type=int, default=300)
    parser.add_argument("--first-seed", type=int, default=1000)
    chosen = parser.parse_args(arguments)
    report(collect(range(chosen.first_seed, chosen.first_seed + chosen.seeds)))


def report(lines):
    """Print the weights of lines, and the score of those of a third of the seeds."""
    held_out = lines.made[:, 1] % 3 == 0
    weights = fit(lines, np.flatnonzero(~held_out))
    print("_WEIGHTS = {")
    for name, weight in zip(lines.names, weights, strict=True):
        print(f'    "{name}": {weight:.2f},')
    print("}")
    p, none = probabilities(lines.looks @ np.round(weights, 2), lines.volume, len(lines.made))
    # The fits of one needle share its probability, and it is found if one of them is the likeliest.
    needle = np.bincount(lines.volume, p * lines.right, len(none))
    other = np.zeros(len(none))
    np.maximum.at(other, lines.volume, p * ~lines.right)
    stated, right = np.maximum(needle, other), needle > other
    for which in (*range(len(GENERATORS)), None):
        chosen = held_out if which is None else held_out & (lines.made[:, 0] == which)
        loss, rows = score(stated[chosen], right[chosen])
        name = "both" if which is None else GENERATORS[which]
        print(f"held out, {name}: log loss {loss:.3f} of {chosen.sum()} volumes")
        for low, high, mean, share, count in rows:
            print(f"  {low} to {high}: stated {mean:.2f}, right {share:.2f} of {count}")


if __name__ == "__main__":
    main()
