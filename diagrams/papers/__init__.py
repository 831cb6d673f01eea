"""Reproductions of published experiments, one package per paper, and their registry.

They import `studies`, `diagrams` and `systems`, but not `app`.
"""
