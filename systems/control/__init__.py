"""Controllers that move the probe.

The package contains the visual servo, the force law, the differential kinematics that turn a twist
into joint velocities, and the guard between controller and arm. It imports only `signals` and
`sampling`.
"""

from lazy_loader import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)
