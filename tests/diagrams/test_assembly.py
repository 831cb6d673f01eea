import numpy as np
import pytest

from sonoservo.diagrams import assemble_arm, load_probe_body
from sonoservo.systems.files.refusals import ConfigurationError


def test_a_probe_of_ones_own_gets_the_dome_of_its_transducer(tmp_path):
    path = tmp_path / "abdominal.yaml"
    path.write_text("transducer: {array_radius: 0.06, motor_radius: 0.05}\n")
    a, b, c = load_probe_body(str(path)).assumed.dome
    assert (a**2 / b, c**2 / b) == pytest.approx((0.06, 0.05))
    path.write_text("body: {assumed: {dome: [0.01, 0.02, 0.03], mass: 0.25}}\n")
    assert load_probe_body(str(path)).assumed.dome == [0.01, 0.02, 0.03]
    assert assemble_arm(probe=str(path)).probe.default_mass() == 0.25


def test_the_probe_may_be_mounted_another_way(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("body: {mount: {translation: [0, 0, 0.05], rotation: !Rpy {deg: [90, 0, 0]}}}")
    arm, plain = assemble_arm(probe=str(path)), assemble_arm()
    positions = [
        each.probe.EvalPoseInWorld(each.plant.CreateDefaultContext()).translation()
        for each in (arm, plain)
    ]
    np.testing.assert_allclose(positions[0] - positions[1], [0, 0, -0.05], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("body: {mass: 1}", r"mine\.yaml: body: mass: unknown field"),
        ("body: {assumed: {mass: 0}}", r"mine\.yaml: body: assumed\.mass: 0"),
        ("bodi: {}", r"mine\.yaml: bodi: unknown section; did you mean 'body'"),
        (
            "body: {directives: [{add_model: {name: probe, file: nowhere.sdf}}]}",
            r"mine\.yaml: directives\.0\.add_model\.file: there is no file",
        ),
        (
            "body: {directives: [{add_model: {name: x, "
            "file: 'package://sonoservo/probes/4dc7_3_40.sdf'}}]}",
            r"mine\.yaml: body\.directives: .*named 'probe'",
        ),
    ],
)
def test_a_mistake_names_the_file_and_the_field(tmp_path, text, message):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message) as error:
        load_probe_body(str(path))
    assert "\n" not in str(error.value)
