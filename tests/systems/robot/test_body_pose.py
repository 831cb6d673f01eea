import numpy as np
from pydrake.common.value import Value
from pydrake.math import RigidTransform
from pydrake.multibody.tree import BodyIndex

from sonoservo.systems.robot.body_pose import BodyPose


def test_it_picks_the_body():
    leaf = BodyPose(body=BodyIndex(2))
    context = leaf.CreateDefaultContext()
    poses = [RigidTransform([i, 0, 0]) for i in range(4)]
    leaf.get_input_port().FixValue(context, Value[list[RigidTransform]](poses))
    np.testing.assert_array_equal(leaf.get_output_port().Eval(context).translation(), [2, 0, 0])
