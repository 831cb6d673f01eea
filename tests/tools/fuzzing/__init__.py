"""Fuzzers: seeded random damage to files, scenarios and command lines."""
