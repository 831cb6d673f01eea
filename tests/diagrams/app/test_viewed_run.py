"""``--log``: a run and a recording's tracking, written for a viewer."""

import numpy as np
from commands import sonoservo_here
from rerun.chunk import RrdReader

from sonoservo.systems.evaluation import RunLog, read_log


def test_a_run_and_its_recording_are_written_for_a_viewer(tmp_path):
    log, out, recording = (tmp_path / each for each in ("run.rrd", "out", "v.seq.nrrd"))
    done = sonoservo_here(
        "run", "chatelain2013_fig5", "--no-meshcat", "--set", "duration=0.7", "--set",
        "scan_conversion.spacing=[2e-3,2e-3,2e-3]", "--out", str(out), "--log", str(log),
        "--record", str(recording),
    )  # fmt: skip
    assert log.is_file(), done.stderr
    chunks = {each.entity_path: each for each in RrdReader(str(log)).stream()}
    assert {"/world/arm", "/world/probe", "/volume", "/slices/along"} <= chunks.keys()
    joint = chunks["/joints/1"].to_record_batch()
    kept = read_log(out / "log.npz", RunLog)
    assert joint.num_rows <= len(kept.time)
    values = np.ravel(joint.column(joint.schema.names[-1]).to_pylist())
    np.testing.assert_allclose(values, kept.joint_state[: len(values), 0])
    tracked = tmp_path / "track.mcap"
    command = ["track", str(recording), "--start", "anywhere", "--show", "--out", str(out)]
    done = sonoservo_here(*command, "--log", str(tracked))
    assert "Watch at http://localhost:" in done.stdout, done.stderr
    assert tracked.stat().st_size > 1000
