"""Study of localization and tracking in volumes made independently of the project's renderer.

``PYTHONPATH=tests/helpers:tests/tools python -m independent_study --volumes 60 --sequences 24
--first-seed 100`` prints its table. Tune with seeds from 100 on only; 0 to 99 are for reports.
"""

from .runs import SEEN, compare, study_sequences, study_volumes
from .tables import quantiles

__all__ = ["SEEN", "compare", "quantiles", "study_sequences", "study_volumes"]
