"""Clusters of Dask distributed, imported on demand: the executor of a study on other machines."""
