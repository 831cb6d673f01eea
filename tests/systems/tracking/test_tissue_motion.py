"""Joint belief about displacements, against the least squares of all comparisons at once."""

import numpy as np
import pytest

from sonoservo.systems.tracking.tissue_motion import TissueMotion


@pytest.fixture
def comparisons():
    """Of eight volumes, each compared with one, two and four before it, and with rest."""
    rng = np.random.default_rng(0)
    true = np.cumsum(rng.normal(size=(8, 3)), axis=0) * 1e-3
    made = []
    for n in range(1, 8):
        rows = []
        for lag in (1, 2, 4):
            if lag <= n:
                root = rng.normal(size=(3, 3)) / 1e-3
                noise = 0.3e-3 * rng.normal(size=3)
                rows.append((n - lag, true[n] - true[n - lag] + noise, root @ root.T))
        made.append(rows)
    return made


REST = np.eye(3) / 5e-3**2


def followed(comparisons, forgotten=()):
    motion, held = TissueMotion(), [0]
    for n, rows in enumerate(comparisons, 1):
        motion = motion.with_volume(REST, [(held.index(m), d, told) for m, d, told in rows])
        held.append(n)
        for number in [each for each in forgotten if each in held and each + 4 < n + 1]:
            motion = motion.without(held.index(number))
            held.remove(number)
    return motion, held


def test_the_means_are_the_least_squares_of_all_comparisons(comparisons):
    rows, right = [], []
    for n, compared in enumerate(comparisons, 1):
        for m, difference, told in [*compared, (0, np.zeros(3), REST)]:
            root = np.linalg.cholesky(told).T
            row = np.zeros((3, 8, 3))
            row[:, n], row[:, m] = root, -root
            rows.append(row[:, 1:].reshape(3, -1))  # the first volume's is zero
            right.append(root @ difference)
    expected = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right))[0].reshape(-1, 3)
    motion, _ = followed(comparisons)
    np.testing.assert_allclose(motion.means[1:], expected, atol=1e-6)
    np.testing.assert_allclose(motion.means[0], 0, atol=1e-8)


def test_a_volume_that_is_forgotten_keeps_telling_about_the_others(comparisons):
    """Each one is forgotten when no later volume is compared with it, so nothing is lost."""
    whole, _ = followed(comparisons)
    motion, held = followed(comparisons, forgotten=(0, 2, 3))
    assert len(held) < 8
    np.testing.assert_allclose(motion.means, whole.means[held], atol=1e-6)
