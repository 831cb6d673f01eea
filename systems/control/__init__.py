"""Controllers: where the probe should go.

It holds the visual servo, the force law, and the differential kinematics from a twist to joint
velocities. It imports `signals` only, and none of `detection`, `localization` and `estimation`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
