"""Study of the belief about lines: are needles among the lines proposed, and is one believed?

``PYTHONPATH=tests/helpers python -m line_study clinic faint --seeds 100 104`` acquires sequences of
the benchmark, and prints a row for each. It is for tuning: seeds from 100 on.
"""
