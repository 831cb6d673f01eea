"""What exists: arm, probe, phantoms, transducers, and one loader for their data."""
