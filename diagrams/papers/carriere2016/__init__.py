"""Carriere et al. (AIM 2016) reproduced."""
