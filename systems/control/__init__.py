"""Controllers that move the probe.

The package contains the visual servo, the force law, and the differential kinematics that turn a
twist into joint velocities. It imports only `signals`, and none of `detection`, `localization` and
`estimation`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
