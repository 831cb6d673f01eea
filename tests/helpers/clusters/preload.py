"""Preload that ends Dask's processes on this machine with the program that started them."""

import os

from sonoservo.diagrams.studies.processes import follow_parent

PARENT = "SONOSERVO_CLUSTER_PARENT"
"""Variable with the number of the process to follow."""


def dask_setup(server: object) -> None:
    """Follow the process that started the cluster."""
    follow_parent(int(os.environ[PARENT]))
