import re

import numpy as np
import pytest
from pydrake.multibody.plant import MultibodyPlant

from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.robot import AddArmWithProbe, MakeArmPlant, load_arm
from sonoservo.systems.robot.arm import set_servo_gains
from sonoservo.systems.robot.directives import motors
from sonoservo.systems.robot.probe_body import AssumedBody, ProbeBody

BODY = ProbeBody(assumed=AssumedBody(dome=[0.03, 0.03, 0.03], mass=0.4, length=0.15))
VIPER = model_path("robots/viper_s850.yaml").read_text()
URDF = model_path("robots/viper_s850.urdf").read_text()


@pytest.fixture
def own(tmp_path):
    """Write an arm of one's own, the Viper with something changed, and return its path."""

    def write(old="", new="", text=VIPER):
        assert old in text
        (tmp_path / "viper_s850.urdf").write_text(URDF)
        path = tmp_path / "mine.yaml"
        path.write_text(text.replace(old, new) if old else text)
        return str(path)

    return write


def test_the_probe_looks_along_the_flange():
    arm = MakeArmPlant(load_arm("viper_s850"), BODY)
    context = arm.plant.CreateDefaultContext()
    X_WF = arm.plant.GetFrameByName("flange").CalcPoseInWorld(context)
    X_FP = X_WF.InvertAndCompose(arm.probe.EvalPoseInWorld(context))
    np.testing.assert_allclose(X_FP.translation(), [0, 0, 0.15], atol=1e-12)
    np.testing.assert_allclose(X_FP.rotation().matrix()[:, 1], [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(X_FP.rotation().matrix()[:, 0], [1, 0, 0], atol=1e-12)


def test_each_motor_gets_its_gains():
    plant = MultibodyPlant(time_step=0.005)
    model = load_arm("lbr_iiwa_14")
    arm = AddArmWithProbe(plant, model, BODY)
    set_servo_gains(arm, model.servo)
    gains = [motor.get_controller_gains() for motor in motors(plant, arm.model_instance)]
    assert [each.p for each in gains] == model.servo.p
    assert [each.d for each in gains] == model.servo.d


def test_an_arm_of_ones_own_lies_beside_its_model_and_may_stand_elsewhere(own):
    turned = '"arm::base_link", X_PC: {translation: [0, 0, 0.3], rotation: !Rpy {deg: [0, 0, 90]}}'
    arm = MakeArmPlant(load_arm(own('"arm::base_link"', turned)), BODY)
    context = arm.plant.CreateDefaultContext()
    X_WB = arm.plant.GetFrameByName("base_link").CalcPoseInWorld(context)
    np.testing.assert_allclose(X_WB.translation(), [0, 0, 0.3])
    np.testing.assert_allclose(X_WB.rotation().matrix()[:, 0], [0, 1, 0], atol=1e-12)


def test_motors_and_speed_limits_that_the_model_lacks_are_added(own, tmp_path):
    path = own(text=VIPER + "max_speed: [1, 2, 3, 4, 5, 6]\n")
    bare = [line for line in URDF.splitlines() if "<transmission" not in line]
    (tmp_path / "viper_s850.urdf").write_text("\n".join(bare))
    arm = MakeArmPlant(load_arm(path), BODY)
    assert arm.plant.num_actuated_dofs() == 6
    np.testing.assert_array_equal(arm.plant.GetVelocityUpperLimits(), [1, 2, 3, 4, 5, 6])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("viper_s850.urdf", "nowhere.urdf", "directives.0.add_model.file: there is no file .*now"),
        ("arm::base_link", "arm::base", "no Frame named 'base'.*link_6"),
        ("flange: flange", "flange: tool0", "flange: the model has no frame 'tool0'.*link_6"),
        ("p: [2.0e5, ", "p: [", r"servo.p: .* must be 6 numbers, one for each joint"),
        ("joint_2: [-1.9198621771937625]", "joint_2: [-110]", "default_joint_positions.joint_2"),
        ("joint_2: [-1.9198621771937625]", "joint_2: -110", r"joint_2: -110 is .* a list"),
        ("name: arm", "name: robot", "no model instance named 'arm'"),
        ('child: "arm::base_link"', "child: world", "directives.1.add_weld.child: 'world'"),
        (', child: "arm::base_link"', "", "directives.1.add_weld.child: is missing"),
        (
            "  - add_weld:",
            "  - add_model: {name: other, file: viper_s850.urdf}\n  - add_weld:",
            "something moves beside the arm",
        ),
        ("add_weld:", "add_wld:", "directives.1.add_wld: unknown.*add_weld"),
        ('"arm::base_link"', '"arm::base_link", X_PC: {rotation: !Rpi {}}', "Rpi"),
        ("flange: flange", "flange: flange\nmax_speed: [1]", "max_speed: .*6 numbers"),
        ('  - add_weld: {parent: world, child: "arm::base_link"}', "", "no add_weld joins"),
        ("torque_error: [0.3", "torque_error: [5", r"torque_error.0: 5.0 .*from 0\.001 to 1 N m"),
    ],
)
def test_a_mistake_names_the_file_and_the_field(own, old, new, message):
    with pytest.raises(ConfigurationError, match=r"mine\.yaml: .*" + message) as error:
        load_arm(own(old, new))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("pattern", "new", "message"),
    [
        (
            r' velocity="[^"]*"',
            ' velocity="0" ',
            r"max_speed of joint_1: 0\.0 is not .*cannot move",
        ),
        (r"(?s)<inertial>.*?</inertial>", "", "joint_1 moves link_1, which has no mass"),
        (r'lower="([^"]*)" upper="([^"]*)"', r'lower="\2" upper="\1"', "mine.yaml: .*limits"),
        (r'(joint_6" type=)"revolute"', r'\1"continuous"', ""),
    ],
    ids=["no speed", "no inertia", "reversed limits", "continuous"],
)
def test_arm_that_cannot_move_is_refused(own, tmp_path, pattern, new, message):
    path = own()
    changed, count = re.subn(pattern, new, URDF)
    assert count > 0
    (tmp_path / "viper_s850.urdf").write_text(changed)
    if message:
        with pytest.raises(ConfigurationError, match=message):
            load_arm(path)
    else:
        load_arm(path)


def test_too_few_joints_and_unordered_motors_are_refused(own, tmp_path):
    path = own()
    model = tmp_path / "viper_s850.urdf"
    model.write_text(URDF.replace('name="joint_6" type="revolute"', 'name="joint_6" type="fixed"'))
    with pytest.raises(ConfigurationError, match="joint_6"):
        load_arm(path)
    lines = URDF.splitlines()
    swapped = [line for line in lines if 'actuator name="motor_1"' not in line]
    (motor,) = [line for line in lines if 'actuator name="motor_1"' in line]
    model.write_text("\n".join([*swapped[:-1], motor, swapped[-1]]))
    with pytest.raises(ConfigurationError, match="transmissions are not in the order"):
        load_arm(path)
