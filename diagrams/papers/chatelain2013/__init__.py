"""Chatelain, Krupa and Marchal (ICRA 2013) reproduced."""
