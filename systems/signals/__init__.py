"""Values that travel on the wires between systems."""
