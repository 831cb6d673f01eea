"""Reproduction of Carriere et al. (AIM 2016): prediction of the shape of needles."""
