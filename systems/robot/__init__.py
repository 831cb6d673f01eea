"""The simulated robot's own parts: its wrist force sensor and the moving base of the phantom."""
