"""Leaf system that outputs the true contact force between probe and phantom."""

import numpy as np
from pydrake.math import RigidTransform
from pydrake.multibody.plant import ContactResults
from pydrake.systems.framework import BasicVector, Context, LeafSystem

from sonoservo.systems.signals.body_surface import BodySurface
from sonoservo.systems.signals.ports import declare_inputs, evaluate


def normal_force(
    contact: ContactResults, X_WT: RigidTransform, surface: BodySurface | None = None
) -> float:
    """Return the force in N that presses the phantom's surface inwards, over all contacts."""
    total = np.zeros(3)
    normal = X_WT.rotation().matrix()[:, 2]
    place = None
    for i in range(contact.num_hydroelastic_contacts()):
        patch = contact.hydroelastic_contact_info(i)
        total += patch.F_Ac_W().translational()
        place = patch.contact_surface().centroid()
    for i in range(contact.num_point_pair_contacts()):
        pair = contact.point_pair_contact_info(i)
        total += pair.contact_force()
        place = pair.contact_point()
    if surface is not None and surface.is_curved and place is not None:
        normal = X_WT.rotation().multiply(surface.normal(X_WT.inverse().multiply(place)))
    return float(abs(normal @ total))


class ContactForce(LeafSystem):
    """Outputs the true normal force between probe and phantom, for logs and figures only.

    .. pydrake_system::

        name: ContactForce
        input_ports:
        - contact_results
        - X_WT
        output_ports:
        - contact_force

    `contact_results` is the plant's ContactResults, and `X_WT` is a RigidTransform.
    `contact_force` has one element, in N. Ground truth must not be used for control.

    Parameters
    ----------
    surface
        Surface of the phantom; level by default.
    """

    def __init__(self, *, surface: BodySurface | None = None) -> None:
        super().__init__()
        self._surface = surface
        declare_inputs(self, contact_results=ContactResults, X_WT=RigidTransform)
        self.DeclareVectorOutputPort("contact_force", 1, self._calc_contact_force)

    def _calc_contact_force(self, context: Context, output: BasicVector) -> None:
        contact = self.GetInputPort("contact_results").Eval(context)
        X_WT = evaluate(self, context, "X_WT", RigidTransform)
        output.SetAtIndex(0, normal_force(contact, X_WT, self._surface))
