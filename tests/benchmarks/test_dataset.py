"""Cost of a data set: processor time and bytes of a volume, and so of a million."""

import time

import pytest

from sonoservo.diagrams import load_scenario
from sonoservo.diagrams.studies import make_dataset

VOLUMES = 10
"""Number of volumes in each of the sequences."""


@pytest.mark.slow
@pytest.mark.parametrize("randomize", [False, True], ids=["", "randomized"])
def test_a_data_set_for_nnunet(benchmark, tmp_path, randomize):
    """Sequences are made in this process, from the draws to the files."""
    seconds, folders = [], iter(range(1000))

    def make():
        count, folder = 4 if seconds else 1, tmp_path / str(next(folders))
        scenario = load_scenario("chatelain2013_fig5", seed=100)
        began = time.process_time()
        manifest = make_dataset(
            scenario, folder, count=count, volumes=VOLUMES, randomize=randomize,
            layout="nnunet", jobs=1,
        )  # fmt: skip
        seconds.append((time.process_time() - began) / count / VOLUMES)
        assert not manifest["failed"]
        return folder

    make()
    folder = benchmark.pedantic(make, rounds=1)
    files = [path for path in folder.rglob("*") if path.suffix in (".nrrd", ".json")]
    size = sum(path.stat().st_size for path in files) / 4 / VOLUMES
    benchmark.extra_info.update(
        volumes_per_s_and_core=1 / seconds[-1],
        core_hours_of_a_million=1e6 * seconds[-1] / 3600,
        terabytes_of_a_million=size / 1e6,
    )
