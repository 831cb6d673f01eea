"""Command that prints the table of the study."""

import argparse
from functools import partial
from pathlib import Path

from .needles import CONTRASTS, DEPTHS, DIPS
from .runs import study
from .tables import HEAD, plot


def main(arguments=None):
    """Print the table."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--volumes", type=int, default=50, help="volumes of each kind of needle")
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--dips", type=float, nargs="+", default=DIPS, help="in deg")
    parser.add_argument("--depths", type=float, nargs="+", default=DEPTHS, help="in m")
    parser.add_argument("--contrasts", type=float, nargs="+", default=CONTRASTS, help="in dB")
    parser.add_argument("--figure", type=Path, help="file for a figure")
    chosen = parser.parse_args(arguments)

    say = partial(print, flush=True)
    say(*HEAD, sep="\n")
    kinds = {"dips": chosen.dips, "depths": chosen.depths, "contrasts": chosen.contrasts}
    rows = study(chosen.volumes, chosen.first_seed, say, **kinds)
    if chosen.figure:
        plot(rows, chosen.figure)


if __name__ == "__main__":
    main()
