"""Structures in the tissue: bone, vessels, fascia, calcifications, gas, wires, needles at rest."""
