"""Reproduction of Zhao, Liebgott and Cachard (Acoustics 2012): a needle's axis and tip."""
