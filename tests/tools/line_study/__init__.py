"""Study of the belief about lines: where needles are lost, and what is believed that is none.

``PYTHONPATH=tests/helpers:tests/tools python -m line_study clinic faint --seeds 100 104``
acquires sequences, keeps them, and prints a row for each. It is for tuning: seeds from 100 on.
"""
