"""Drake model directives, with errors that name the directive, and the motors of a model."""

import re
from collections.abc import Mapping
from pathlib import Path

from pydrake.multibody.parsing import (
    ModelDirective,
    ModelDirectives,
    Parser,
    ProcessModelDirectives,
)
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import JointActuator, ModelInstanceIndex

from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.robot.stl_meshes import without_stl

# Kinds of directives and their required fields, without which Drake aborts the process.
_WANTED = {
    "add_model": ("file", "name"),
    "add_model_instance": ("name",),
    "add_frame": ("name",),
    "add_weld": ("parent", "child"),
    "add_collision_filter_group": ("name",),
    "add_directives": ("file",),
}


def resolve_files(
    directives: list[ModelDirective], path: Path, packages: dict[str, str] | None = None
) -> None:
    """Check directives from a YAML file, and make their relative names absolute, in place."""
    packages = {} if packages is None else packages
    for name, folder in packages.items():
        packages[name] = str((path.parent / folder).absolute())
        if not Path(packages[name]).is_dir():
            raise ConfigurationError(f"{path}: packages.{name}: there is no folder {folder}")
    for number, directive in enumerate(directives):
        kinds = [kind for kind in _WANTED if getattr(directive, kind) is not None]
        where = f"{path}: directives.{number}"
        if len(kinds) != 1:
            raise ConfigurationError(f"{where}: must be one of {', '.join(_WANTED)}")
        (kind,) = kinds
        content = getattr(directive, kind)
        for name in _WANTED[kind]:
            if not getattr(content, name):
                raise ConfigurationError(f"{where}.{kind}.{name}: is missing")
        if kind == "add_weld" and content.child == "world":
            raise ConfigurationError(f"{where}.add_weld.child: 'world' can only be the parent")
        if "file" in _WANTED[kind] and "://" not in content.file:
            file = (path.parent / content.file).absolute()
            if not file.is_file():
                raise ConfigurationError(f"{where}.{kind}.file: there is no file {file}")
            content.file = f"file://{without_stl(file, packages)}"


def add_directives(
    plant: MultibodyPlant,
    directives: list[ModelDirective],
    packages: Mapping[str, str] | None = None,
) -> None:
    """Add the models that directives describe to a plant; they may name files in packages."""
    parser = Parser(plant)
    parser.package_map().AddPackageXml(str(model_path("package.xml")))
    for name, folder in (packages or {}).items():
        parser.package_map().Add(name, folder)
    try:
        ProcessModelDirectives(ModelDirectives(directives=directives), parser)
    except (RuntimeError, SystemExit) as error:  # the latter by Drake's own assertions
        said = " ".join(str(error).split())
        unknown = re.search(r"unknown package '(.+?)'", said)
        if unknown and packages is not None:
            said += f"; give its folder in the YAML file: packages: {{{unknown[1]}: path/of/it}}"
        raise ValueError(f"directives: {said}") from error


def motors(plant: MultibodyPlant, instance: ModelInstanceIndex) -> list[JointActuator]:
    """Return the motors of a model's joints, in the order of their commands."""
    # Before it is finalized, a plant can list all its actuators but not those of one model.
    every = [plant.get_joint_actuator(index) for index in plant.GetJointActuatorIndices()]
    return [motor for motor in every if motor.model_instance() == instance]
