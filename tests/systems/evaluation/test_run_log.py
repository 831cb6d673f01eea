from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sonoservo.systems import evaluation
from sonoservo.systems.evaluation import RunLog, ShapeLog, read_log
from sonoservo.systems.evaluation.explanation.explained_volume import ExplainedVolume
from sonoservo.systems.evaluation.log import FORMAT, column_table, columns, write_log


def test_a_log_survives_its_file(tmp_path, insertion_log, make_log):
    log = read_log(write_log(tmp_path / "log.npz", insertion_log), RunLog)
    for name in columns(RunLog):
        np.testing.assert_array_equal(getattr(log, name), getattr(insertion_log, name), name)
    np.testing.assert_array_equal(log.compute["track"], insertion_log.compute["track"])
    assert not log.time.flags.writeable
    log = read_log(write_log(tmp_path / "log.npz", make_log(0, 0)), RunLog)
    assert (log.time.shape, log.X_WP.shape) == ((0,), (0, 4, 4))


@pytest.mark.parametrize("kept", [0, 0.99, 1.0])
def test_a_truncated_or_damaged_file_is_refused(tmp_path, insertion_log, kept):
    path = write_log(tmp_path / "log.npz", insertion_log)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data[: kept if isinstance(kept, int) else int(kept * len(data))])
    with pytest.raises(ValueError, match="log.npz: not a log, or incomplete"):
        read_log(path, RunLog)


def test_other_files_and_logs_of_another_kind_are_refused(tmp_path, insertion_log):
    path = tmp_path / "other.npz"
    for arrays, said in (({}, "format None"), ({"format": FORMAT}, r"lacks .* X_WP, X_WT, .*time")):
        np.savez(path, time=np.zeros(3), **arrays)
        with pytest.raises(ValueError, match=said):
            read_log(path, RunLog)
    with pytest.raises(ValueError, match=r"lacks the arrays correlation, depth, .*tip_covariance"):
        read_log(write_log(path, insertion_log), ShapeLog)


def test_arrays_must_agree(insertion_log):
    with pytest.raises(ValueError, match=r"needle_tip has shape \(3, 3\); it must be \(n, 3\)"):
        replace(insertion_log, needle_tip=np.zeros((3, 3)))


def test_the_readme_names_every_array():
    readme = Path(evaluation.__file__).with_name("README.md").read_text()
    assert column_table(RunLog) in readme
    assert column_table(ShapeLog) in readme
    assert column_table(ExplainedVolume) in readme
