"""Typed YAML in, whole files out."""
