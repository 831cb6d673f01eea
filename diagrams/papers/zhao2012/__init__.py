"""Zhao, Liebgott and Cachard (Acoustics 2012) reproduced."""
