"""Study of the tip's error along the needle in one volume, beside the least possible error.

``PYTHONPATH=tests/helpers:tests/tools python -m tip_study --volumes 50 --first-seed 100`` prints
its table. Tune with seeds from 100 on only; seeds 0 to 99 are for reports.
"""

from .needles import CONTRASTS, DEPTHS, DIPS, TIPS, End, end_of, sweep_with
from .runs import study

__all__ = ["CONTRASTS", "DEPTHS", "DIPS", "TIPS", "End", "end_of", "study", "sweep_with"]
