import numpy as np
from pydrake.common.value import Value
from pydrake.multibody.math import SpatialForce
from pydrake.systems.analysis import Simulator

from sonoservo.systems.robot import SensorFaults
from sonoservo.systems.robot.errors.sensor_faults import KINDS, SensorFault, faulty_sample

SAMPLE, HELD = np.arange(6.0), np.arange(6.0) + 10


def test_each_kind_distorts_a_sample_in_its_own_way():
    def of(kind, number=1, value=3.0):
        return faulty_sample(SensorFault(kind=kind, value=value), SAMPLE, HELD, number, 0.02)

    assert np.isnan(of("nan")).all()
    assert (of("frozen") == HELD).all()
    assert (of("saturated") == [0, 1, 2, 3, 3, 5]).all()
    assert (of("bias") == [0, 1, 2, 3, 7, 5]).all()
    assert (of("jumping", number=1) == of("bias")).all()
    assert (of("jumping", number=2) == SAMPLE).all()
    assert 0 < np.abs(of("dead")).max() < 0.1
    assert len(KINDS) == 6


def test_leaf_distorts_only_while_the_fault_holds():
    leaf = SensorFaults(
        faults=[SensorFault(kind="frozen", start=0.1, duration=0.1)], period=0.01, noise=0.0
    )
    simulator = Simulator(leaf)
    context = simulator.get_mutable_context()
    read = []
    for number in range(30):
        force = SpatialForce(np.full(6, float(number)))
        leaf.GetInputPort("wrist_force").FixValue(context, Value(force))
        simulator.AdvanceTo(0.01 * number + 0.005)
        read.append(leaf.GetOutputPort("wrist_force").Eval(context).get_coeffs()[0])
    held = read[15]
    assert held in (9, 10)
    assert read[:10] == list(range(10))
    assert set(read[11:19]) == {held}
    assert read[21:] == list(range(21, 30))
