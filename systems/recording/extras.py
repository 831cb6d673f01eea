"""Packages that only some formats need."""

from importlib import import_module
from types import ModuleType

from sonoservo.systems.files.refusals import ConfigurationError


def require_extra(module: str, extra: str, source: object) -> ModuleType:
    """Return a module of an optional package, or name the extra that brings it."""
    try:
        return import_module(module)
    except ModuleNotFoundError as error:
        raise ConfigurationError(
            f"{source}: this needs the package {module.partition('.')[0]}; install it with "
            f"pip install 'sonoservo[{extra}]'"
        ) from error
