"""Packages of the import name ``sonoservo``, whose folders stand at the repository's root."""

from setuptools import find_packages, setup

FOLDERS = ("diagrams", "models", "systems")
found = find_packages(include=[*FOLDERS, *(f"{folder}.*" for folder in FOLDERS)])
setup(packages=[f"sonoservo.{name}" for name in found])
