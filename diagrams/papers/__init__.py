"""Reproductions of published experiments, one room for each paper.

Each hands out `reproduce`, which makes a study. They import `studies`, `diagrams` and
`systems`, but not `app`.
"""
