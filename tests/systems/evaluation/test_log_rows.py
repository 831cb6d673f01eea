import tracemalloc

import numpy as np

from sonoservo.systems.evaluation.log import Column, stack_rows
from sonoservo.systems.evaluation.log_rows import LogRows

COLUMNS = {
    "time": Column("time", "s", ("n",)),
    "pose": Column("pose", "m", ("n", 4, 4)),
    "joints": Column("joints", "rad", ("n", "j")),
    "seen": Column("seen", "", ("n",), "?"),
    "mode": Column("mode", "", ("n",), "U"),
}
EXTENTS = {"j": 6}


def make_row(number):
    """A row of which every third one lacks something."""
    row = {"time": 0.1 * number, "pose": np.full((4, 4), number), "mode": "lost" + number % 2 * "!"}
    return row | ({"joints": np.arange(6) + number, "seen": True} if number % 3 else {})


def test_packed_rows_are_the_same_to_the_last_bit():
    rows = LogRows(COLUMNS, EXTENTS)
    for count in (0, 1, 255, 256, 257, 1000):
        rows.clear()
        made = [make_row(number) for number in range(count)]
        for row in made:
            rows.append(row)
        arrays = rows.arrays()
        for name, column in COLUMNS.items():
            wanted = stack_rows(column, name, made, EXTENTS)
            np.testing.assert_array_equal(arrays[name], wanted)
            assert arrays[name].dtype == wanted.dtype
            assert arrays[name].shape == wanted.shape
        assert rows.newest is (made[-1] if made else None)
        rows.append(make_row(count))
        np.testing.assert_array_equal(arrays["time"], [row["time"] for row in made])
        assert rows.arrays()["time"].tolist() == [row["time"] for row in [*made, make_row(count)]]


def test_a_row_takes_little_more_than_its_numbers():
    rows = LogRows(COLUMNS, EXTENTS)
    tracemalloc.start()
    for number in range(5000):
        rows.append(make_row(number))
    kept, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    numbers = 5000 * (8 * (1 + 16 + 6) + 1 + 8)
    assert kept < 1.1 * numbers + 400_000  # the rows that are not packed yet
