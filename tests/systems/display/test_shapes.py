import numpy as np

from sonoservo.systems.display.shapes import sector_edges


def test_the_edges_of_a_sector_are_its_edges(geometry):
    edges = sector_edges(geometry)
    assert len(edges) == 12
    ends = np.array(geometry.shape) - 1
    corners = set()
    for edge in edges:
        index = np.stack(geometry.index(edge, 1), axis=1)
        at_end = np.isclose(index, 0, atol=1e-6) | np.isclose(index, ends, atol=1e-6)
        assert (at_end.sum(axis=1) >= 2).all()
        assert (at_end[[0, -1]]).all()
        corners |= {tuple(each) for each in np.rint(index[[0, -1]] / ends).astype(int).tolist()}
    assert len(corners) == 8
