"""How blocks are wired: station, tracker, controller; experiments and their scenarios.

What a person runs is handed out here too:

>>> from sonoservo.diagrams import load_scenario, run
>>> result = run(load_scenario("chatelain2013_fig5", seed=1))
>>> result.summary["servo"]["at_rest"]

The rooms in it are `trackers`, `experiments`, `studies`, `papers` and `app`. It imports `systems`
and `models`, and of its own rooms `trackers` only.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
