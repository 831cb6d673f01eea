"""Reproduction of Chatelain, Krupa and Marchal (ICRA 2013): needles are found and followed."""
