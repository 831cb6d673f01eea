"""Diagrams made of the systems: station, tracker, controller, and experiments with scenarios.

The package also exports the functions behind the commands:

>>> from sonoservo.diagrams import load_scenario, run
>>> result = run(load_scenario("chatelain2013_fig5", seed=1))
>>> result.summary["servo"]["at_rest"]

Its rooms are `trackers`, `experiments`, `studies`, `papers`, `benchmark`, `environment` and `app`.
The modules outside these rooms import `systems`, `models` and `trackers` only.
"""

from lazy_loader import attach_stub

import sonoservo.systems  # noqa: F401  (prepares NumPy's libraries)

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
