import numpy as np

from sonoservo.systems.signals.tissue_record import TissueRecord

DISTANCE = np.arange(-0.01, 0.05, 0.4e-3)


def test_a_place_is_found_again_from_another_start():
    contrast = 1e3 * DISTANCE
    record = TissueRecord.unseen(0.25e-3).seen(DISTANCE, contrast, DISTANCE > 0.02)
    mean, looks = record.at(DISTANCE[10:] + 0.1e-3)
    known = (DISTANCE[10:] > 0.021) & (DISTANCE[10:] < 0.049)
    np.testing.assert_allclose(mean[known], contrast[10:][known] + 0.1, atol=1e-9)
    assert (looks[known] == 1).all()
    assert (looks[DISTANCE[10:] < 0.019] == 0).all()


def test_looks_are_averaged_and_old_ones_forgotten():
    record, everywhere = TissueRecord.unseen(0.25e-3), np.ones(len(DISTANCE), bool)
    for level in (4.0, 8.0):
        record = record.seen(DISTANCE, np.full(len(DISTANCE), level), everywhere)
    np.testing.assert_allclose(record.at(np.array([0.02]))[0], 6.0)
    for _ in range(100):
        record = record.seen(DISTANCE, np.full(len(DISTANCE), -3.0), everywhere)
    np.testing.assert_allclose(record.at(np.array([0.02]))[0], -3.0, atol=1e-3)
