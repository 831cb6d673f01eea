import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from sonoservo.systems.display.shapes import resample, sector_edges, segment_pose

point = st.tuples(*[st.floats(-1, 1)] * 3)


@given(point, point)
@example((1.0, 2.0, 3.0), (1.0, 2.0, 3.0))
def test_a_segment_ends_where_it_should(start, end):
    X, length = segment_pose(start, end)
    np.testing.assert_allclose(X.multiply([0, 0, -length / 2]), start, atol=1e-9)
    np.testing.assert_allclose(X.multiply([0, 0, length / 2]), end, atol=1e-9)


def test_resampling_a_corner():
    result = resample([[0, 0, 0], [3, 0, 0], [3, 1, 0]], 5)
    np.testing.assert_allclose(result[:, :2], [[0, 0], [1, 0], [2, 0], [3, 0], [3, 1]])


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
