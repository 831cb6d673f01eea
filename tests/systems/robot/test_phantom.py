import numpy as np
import pytest
from pydrake.geometry import Box, Role, SceneGraph
from pydrake.multibody.plant import MultibodyPlant
from pydrake.trajectories import PiecewisePolynomial

from sonoservo.systems.robot.phantom import AddPhantom, PhantomContact, PhantomMotion, load_contact
from sonoservo.systems.signals.body_surface import BodySurface

SIZE = [0.3, 0.2, 0.05]


def test_phantom_has_the_size_asked_for_below_frame_t():
    plant, scene_graph = MultibodyPlant(time_step=0.001), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    phantom = AddPhantom(plant, scene_graph, surface=BodySurface(SIZE))
    plant.Finalize()
    inspector = scene_graph.model_inspector()
    frame = plant.GetBodyFrameIdOrThrow(phantom.body.index())
    boxes = []
    for role in (Role.kProximity, Role.kIllustration):
        for geometry in inspector.GetGeometries(frame, role):
            shape = inspector.GetShape(geometry)
            centre = inspector.GetPoseInFrame(geometry).translation()
            boxes.append((shape, centre[2] + shape.height() / 2))
    assert [(shape.size().tolist(), round(top, 9)) for shape, top in boxes[:2]] == [(SIZE, 0)] * 2
    (tray, top) = boxes[2]
    assert isinstance(tray, Box)
    assert top < -SIZE[2]


def test_the_box_has_the_contact_asked_for():
    plant, scene_graph = MultibodyPlant(time_step=0.001), SceneGraph()
    plant.RegisterAsSourceForSceneGraph(scene_graph)
    contact = PhantomContact(hydroelastic_modulus=1e4, point_contact_stiffness=300, friction=0.1)
    phantom = AddPhantom(plant, scene_graph, surface=BodySurface(SIZE), contact=contact)
    (box,) = plant.GetCollisionGeometriesForBody(phantom.body)
    properties = scene_graph.model_inspector().GetProximityProperties(box)
    assert properties.GetProperty("hydroelastic", "hydroelastic_modulus") == 1e4
    assert properties.GetProperty("material", "point_contact_stiffness") == 300
    assert properties.GetProperty("material", "coulomb_friction").static_friction() == 0.1


def test_contact_loads_from_the_phantoms_file(tmp_path):
    assert load_contact("agar") == load_contact("beef") == PhantomContact()
    path = tmp_path / "mine.yaml"
    path.write_text("contact: {hydroelastic_modulus: 3.0e4}\n")
    assert load_contact(str(path)).hydroelastic_modulus == 3e4
    path.write_text("contact: {hydroelastic_modulus: -1}\n")
    with pytest.raises(ValueError, match=r"mine\.yaml: contact: hydroelastic_modulus: -1"):
        load_contact(str(path))


def test_motion_gives_position_and_velocity():
    trajectory = PiecewisePolynomial.FirstOrderHold(
        [0, 2], np.array([np.zeros(6), np.arange(6.0)]).T
    )
    source = PhantomMotion(trajectory=trajectory)
    context = source.CreateDefaultContext()
    context.SetTime(0.5)
    command = source.get_output_port().Eval(context)
    np.testing.assert_allclose(command, np.concatenate([np.arange(6) / 4, np.arange(6) / 2]))
