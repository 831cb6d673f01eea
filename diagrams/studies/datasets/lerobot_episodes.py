"""Episodes in the layout of LeRobot's data sets (version 3), from runs that follow a needle."""

import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray
from PIL import Image
from rich.console import Console

from sonoservo.diagrams.experiments.experiment import Experiment
from sonoservo.diagrams.experiments.following import FollowingExperiment
from sonoservo.diagrams.experiments.following_scenario import FollowingScenario
from sonoservo.diagrams.experiments.registry import load_scenario
from sonoservo.diagrams.scenario import Scenario, require_scenario
from sonoservo.diagrams.studies.runs import run_cases
from sonoservo.diagrams.studies.study import Case, Executor, Outcome, WithFiles
from sonoservo.systems.evaluation.run_errors import features
from sonoservo.systems.evaluation.run_log import RunLog
from sonoservo.systems.files.refusals import ConfigurationError, require_extra
from sonoservo.systems.files.writing import write_atomically, write_json
from sonoservo.systems.signals.needle_estimate import TrackingMode
from sonoservo.systems.signals.volume import Volume

VERSION = "v3.0"  # version of the layout

TASK = "Follow the needle with the ultrasound probe and press with the wanted force"

NAMES: Mapping[str, Sequence[str]] = {
    "observation.features": ("x", "z", "theta", "tracked"),
    "observation.force": ("torque_x", "torque_y", "torque_z", "force_x", "force_y", "force_z"),
    "action": ("v_x", "v_z", "omega_y", "force_target"),
}
"""Elements of the vectors, in m, rad, N m, N, m/s and rad/s; ``observation.state`` are joints."""

_IMAGES = ("observation.images.along", "observation.images.across")
_DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

Floats = NDArray[np.float32]


def make_episodes(
    scenario: Scenario,
    out: Path,
    *,
    count: int,
    jobs: int = -1,
    cluster: Executor | None = None,
    console: Console | None = None,
) -> dict[str, Any]:
    """Run a scenario with several seeds from its own on, and write its episodes for LeRobot."""
    require_extra("pyarrow", "lerobot", out)
    scenario = require_scenario(scenario, FollowingScenario)
    settings = {"scenario": scenario.to_yaml()}
    cases = [Case("episode", scenario.seed + k, settings) for k in range(count)]
    outcomes = run_cases(
        run_episode, cases, out / "cases", jobs=jobs, cluster=cluster, console=console
    )
    done = [each for each in outcomes if each]
    if not done:
        raise ConfigurationError(f"{out}: no episode could be made: {outcomes[0].error}")
    return _write(out, done, scenario.imaging.volume_rate)


def run_episode(case: Case) -> WithFiles:
    """Run an episode, and return its frames as a file of NumPy."""
    loaded = load_scenario(yaml.safe_load(case.settings["scenario"]), seed=case.seed)
    scenario = require_scenario(loaded, FollowingScenario)
    experiment = FollowingExperiment(scenario)
    planes: dict[float, tuple[bytes, bytes]] = {}

    def keep(experiment: Experiment[Any]) -> None:
        assert isinstance(experiment, FollowingExperiment)
        volume = experiment.evaluate(experiment.scan_converter, "volume")
        if isinstance(volume, Volume):
            planes[volume.time] = middle_planes(volume)

    experiment.run(keep)
    log = experiment.log()
    frames = episode_frames(log, scenario)
    images = [planes[float(each)] for each in log.volume_time]
    buffer = io.BytesIO()
    np.savez(buffer, **frames, **{  # type: ignore[arg-type]
        name: np.array([each[k] for each in images], dtype=object)
        for k, name in enumerate(_IMAGES)
    })  # fmt: skip
    return WithFiles({"frames": len(images)}, {f"{case.name}.npz": buffer.getvalue()})


def middle_planes(volume: Volume) -> tuple[bytes, bytes]:
    """Return the planes Z = 0 and X = 0 of a volume as PNG with three equal channels."""
    grey = np.rint(volume.intensities).astype(np.uint8)
    planes = grey[:, :, grey.shape[2] // 2].T, grey[grey.shape[0] // 2]
    return _png(planes[0]), _png(planes[1])


def _png(grey: NDArray[np.uint8]) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(grey).convert("RGB").save(buffer, "PNG")
    return buffer.getvalue()


def episode_frames(log: RunLog, scenario: FollowingScenario) -> dict[str, Floats]:
    """Return the vectors of each volume of a run, by name; what is not known is 0."""
    sample = np.minimum(np.searchsorted(log.time, log.volume_seen), len(log.time) - 1)
    seen = features(log.measured_X_WP, log.estimate_tip, log.estimate_entry)[sample]
    tracked = log.estimate_mode[sample] == TrackingMode.TRACKING
    schedule = scenario.controller_schedule
    force = [schedule.at(float(time)).force for time in log.volume_seen]
    joints = log.joint_state[sample, : log.joint_state.shape[1] // 2]
    vectors = {
        "observation.state": joints,
        "observation.features": np.column_stack([seen, tracked]),
        "observation.force": log.wrist_force[sample],
        "action": np.column_stack([log.planar_velocity[sample], force]),
    }
    return {name: np.nan_to_num(each).astype(np.float32) for name, each in vectors.items()}


def _write(out: Path, done: Sequence[Outcome], fps: float) -> dict[str, Any]:
    import pyarrow as pa

    episodes = []
    for outcome in done:
        (name,) = outcome.files
        with np.load(out / "cases" / name, allow_pickle=True) as file:
            episodes.append({key: file[key] for key in file.files})
    lengths = [len(each["action"]) for each in episodes]
    ends = np.cumsum(lengths)
    vectors = {key: np.concatenate([each[key] for each in episodes])
               for key in episodes[0] if key not in _IMAGES}  # fmt: skip
    counted = {
        "timestamp": np.concatenate([np.arange(n) / fps for n in lengths]).astype(np.float32),
        "frame_index": np.concatenate([np.arange(n) for n in lengths]),
        "episode_index": np.repeat(np.arange(len(lengths)), lengths),
        "index": np.arange(ends[-1]),
        "task_index": np.zeros(ends[-1], int),
    }
    columns = {
        key: pa.FixedSizeListArray.from_arrays(pa.array(each.ravel()), each.shape[1])
        for key, each in vectors.items()
    }
    for key in _IMAGES:
        coded = [{"bytes": png, "path": None} for each in episodes for png in each[key]]
        kind = pa.struct([("bytes", pa.binary()), ("path", pa.string())])
        columns[key] = pa.array(coded, kind)
    columns |= {key: pa.array(each) for key, each in counted.items()}
    _parquet(out / _DATA.format(chunk_index=0, file_index=0), pa.table(columns))
    starts = [0, *ends[:-1].tolist()]
    zeros = [0] * len(lengths)
    _parquet(out / "meta/episodes/chunk-000/file-000.parquet", pa.table({
        "episode_index": list(range(len(lengths))), "tasks": [[TASK]] * len(lengths),
        "length": lengths, "dataset_from_index": starts, "dataset_to_index": ends.tolist(),
        "data/chunk_index": zeros, "data/file_index": zeros,
        "meta/episodes/chunk_index": zeros, "meta/episodes/file_index": zeros,
    }))  # fmt: skip
    _parquet(out / "meta/tasks.parquet", _tasks())
    write_json(out / "meta/stats.json", {
        key: _statistics(each.reshape(len(each), -1)) for key, each in (vectors | counted).items()
    })  # fmt: skip
    info = _info(vectors, episodes[0], lengths, fps)
    write_json(out / "meta/info.json", info)
    return info


def _tasks() -> Any:
    """Return the table of tasks, whose text is the index of a table of pandas."""
    import pyarrow as pa

    table = pa.table({"task_index": [0], "__index_level_0__": [TASK]})
    named = {"name": None, "field_name": "__index_level_0__", "pandas_type": "unicode",
             "numpy_type": "object", "metadata": None}  # fmt: skip
    number = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64",
              "numpy_type": "int64", "metadata": None}  # fmt: skip
    pandas = {"index_columns": ["__index_level_0__"], "columns": [number, named],
              "column_indexes": [], "pandas_version": "2.0.0"}  # fmt: skip
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def _info(
    vectors: Mapping[str, Floats], first: Mapping[str, Any], lengths: Sequence[int], fps: float
) -> dict[str, Any]:
    described: dict[str, Any] = {}
    for key, each in vectors.items():
        names = NAMES.get(key) or [f"joint_{k + 1}" for k in range(each.shape[1])]
        described[key] = {"dtype": "float32", "shape": [each.shape[1]], "names": list(names)}
    for key in _IMAGES:
        with Image.open(io.BytesIO(first[key][0])) as image:
            shape = [image.height, image.width, 3]
        names = ["height", "width", "channels"]
        described[key] = {"dtype": "image", "shape": shape, "names": names}
    for key in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        dtype = "float32" if key == "timestamp" else "int64"
        described[key] = {"dtype": dtype, "shape": [1], "names": None}
    return {
        "codebase_version": VERSION, "robot_type": "sonoservo", "total_episodes": len(lengths),
        "total_frames": sum(lengths), "total_tasks": 1, "chunks_size": 1000,
        "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": fps,
        "splits": {"train": f"0:{len(lengths)}"}, "data_path": _DATA, "video_path": None,
        "features": described,
    }  # fmt: skip


def _statistics(values: NDArray[Any]) -> dict[str, list[float]]:
    return {
        **{name: getattr(values, name)(axis=0).astype(float).tolist()
           for name in ("min", "max", "mean", "std")},
        "count": [len(values)],
    }  # fmt: skip


def _parquet(path: Path, table: Any) -> None:
    import pyarrow.parquet as pq

    buffer = io.BytesIO()
    pq.write_table(table, buffer)
    write_atomically(path, buffer.getvalue())
