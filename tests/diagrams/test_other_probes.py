"""The same settings with other probes: lenses and arrays that no parameter was chosen for."""

import numpy as np
import pytest
import yaml

from sonoservo.diagrams import load_scenario, scan
from sonoservo.diagrams.studies.robustness.analysis import Record
from sonoservo.diagrams.studies.robustness.planned_motion import run_open_loop
from sonoservo.diagrams.studies.robustness.runs import PLAIN, record
from sonoservo.systems.files.model_file import model_file
from sonoservo.systems.files.typed_yaml import apply_changes, read_yaml
from sonoservo.systems.tracking import NeedleLocalizerParameters
from sonoservo.systems.tracking.needle_blur import streak_lengths
from sonoservo.systems.tracking.needle_line import needle_lines
from sonoservo.systems.ultrasound import load_transducer

TRACKER = "chatelain2013"
LENS_AT_20_MM = {"lens_focus": 0.020}
ABDOMINAL = {
    "array_radius": 0.060,
    "motor_radius": 0.045,
    "line_pitch_deg": 0.5,
    "element_pitch": 0.5e-3,
    "element_width": 0.45e-3,
    "lens_focus": 0.070,
    "lowest_frequency": 2.0e6,
    "highest_frequency": 5.0e6,
}
LINEAR = {
    "array_radius": 5.0,
    "motor_radius": 0.5,
    "line_pitch_deg": 0.0045837,  # 0.4 mm
    "element_pitch": 0.3e-3,
    "element_width": 0.27e-3,
    "element_height": 0.006,
    "lens_focus": 0.040,
    "lowest_frequency": 3.0e6,
    "highest_frequency": 9.0e6,
}
IMAGING = {
    "abdominal": [
        "imaging.transmit_frequency=2.5e6", "imaging.depth=0.12", "imaging.focus_depth=0.05",
    ],
    "linear": [
        "imaging.transmit_frequency=5e6", "imaging.depth=0.07", "imaging.sector=1.0",
        "imaging.frame_pitch_deg=0.115",
    ],
}  # fmt: skip


def write_probe(folder, transducer):
    """Write a probe with another transducer, and return its path."""
    probe = read_yaml(model_file("probes", "4dc7_3_40"))
    apply_changes(probe, {f"transducer.{name}": value for name, value in transducer.items()})
    probe["body"] = {"assumed": {"mass": 0.5, "length": 0.2}}
    path = folder / "probe.yaml"
    path.write_text(yaml.safe_dump(probe))
    return path


def test_scatterers_drawn_out_by_an_unfocused_beam_are_no_needles(tmp_path):
    """At 65 mm, a lens focused at 20 mm draws a point out to 21 mm across the frames."""
    probe = write_probe(tmp_path, LENS_AT_20_MM)
    assert load_transducer(str(probe)).lens_focus == 0.020
    changes = {"probe": str(probe), "phantom": "rough"}  # tissue with nothing in it
    image = scan("chatelain2013_fig5", changes=changes, seed=100, time=0.0)
    lines = needle_lines(image.volume)
    assert not lines or lines[0].probability < NeedleLocalizerParameters().min_probability
    across = np.array([[0.0, 0.065, -0.001], [0.0, 0.065, 0.001]])
    assert 15e-3 < streak_lengths(image.volume, across[np.newaxis]) < 27e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("transducer", "imaging", "found", "kept", "median"),
    [
        (ABDOMINAL, "abdominal", 10, 9, 0.6),
        (LINEAR, "linear", 10, 7, 1.0),
        (LENS_AT_20_MM, "", 4, 0, 3.0),
    ],
    ids=["abdominal", "linear", "lens at 20 mm"],
)
def test_a_needle_is_found_and_followed_with_other_probes(
    tmp_path, transducer, imaging, found, kept, median
):
    """Ten needles; the probe moves as planned, without a robot.

    At the needle's depth, the beam of the lens at 20 mm is 11 mm wide across the frames.
    """
    probe = write_probe(tmp_path, transducer)
    changes = [*PLAIN, "hand.start=1.5", "duration=12.5", f"probe={probe}"]
    runs = []
    for seed in range(10):
        scenario = load_scenario(
            "chatelain2013_fig5", changes=[*changes, *IMAGING.get(imaging, [])], seed=seed
        )
        logs, volumes = run_open_loop(scenario, [TRACKER])
        runs.append(Record.kept_by(record(logs[TRACKER], volumes)))
    tip = np.concatenate([each.tip[each.judged] for each in runs])
    inside = np.concatenate([each.inside["tip"][each.judged] for each in runs])
    numbers = [sum(each.found for each in runs), sum(each.kept for each in runs)]
    errors = np.quantile(tip, [0.5, 0.95], method="inverted_cdf")
    print(f"found, kept: {numbers}; tip in mm: {errors}; inside: {np.nanmean(inside):.3f}")
    assert sum(each.false_starts for each in runs) == 0
    assert numbers[0] >= found
    assert numbers[1] >= kept
    assert errors[0] < median
