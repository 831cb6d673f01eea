"""Motors of one model in a plant that need not be finalized yet."""

from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuator, ModelInstanceIndex


def motors(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[JointActuator]:
    """Return the motors of a model's joints, in the order of their commands."""
    # Before it is finalized, a plant can list all its actuators but not those of one model.
    every = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    return [motor for motor in every if motor.model_instance() == instance]
