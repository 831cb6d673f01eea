"""Arms whose models have meshes in STL and in packages of their own."""

import numpy as np
import pytest
from pydrake.geometry import Mesh, Role
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from sonoservo.models import model_path
from sonoservo.systems.files.refusals import ConfigurationError
from sonoservo.systems.robot import AddArm, load_arm
from sonoservo.systems.robot.stl_meshes import read_stl

CORNERS = np.array([[[0, 0, 0], [0.1, 0, 0], [0, 0.2, 0]], [[0, 0, 0], [0, 0.2, 0], [0, 0, 0.3]]])


def binary(corners):
    facets = np.zeros(len(corners), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("u", "<u2")])
    facets["c"] = corners
    return b"solid of no text".ljust(80) + len(corners).to_bytes(4, "little") + facets.tobytes()


def text(corners):
    lines = [f"vertex {x:g} {y:g} {z:.3e}" for x, y, z in corners.reshape(-1, 3)]
    return "solid mine\nfacet normal 0 0 1\nouter loop\n" + "\n".join(lines) + "\nendsolid"


@pytest.mark.parametrize("content", [binary(CORNERS), text(CORNERS).encode()])
def test_both_kinds_of_stl_are_read(tmp_path, content):
    (tmp_path / "a.stl").write_bytes(content)
    np.testing.assert_allclose(read_stl(tmp_path / "a.stl"), CORNERS, atol=1e-7)


def test_a_file_that_is_no_stl_is_refused(tmp_path):
    (tmp_path / "a.stl").write_bytes(binary(CORNERS)[:-3])
    with pytest.raises(ConfigurationError, match="a.stl: no mesh in STL"):
        read_stl(tmp_path / "a.stl")


def own_arm(folder, mesh):
    """The Viper in a package of one's own, its first link drawn by a mesh; path of its YAML."""
    urdf = model_path("robots/viper_s850.urdf").read_text()
    visual = f'<visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>'
    (folder / "viper_s850.urdf").write_text(urdf.replace("</link>", visual, 1))
    (folder / "mine" / "meshes").mkdir(parents=True)
    (folder / "mine" / "meshes" / "base.STL").write_bytes(binary(CORNERS))
    yaml = model_path("robots/viper_s850.yaml").read_text()
    (folder / "mine.yaml").write_text(f"packages: {{mine: mine}}\n{yaml}")
    return folder / "mine.yaml"


@pytest.mark.parametrize("mesh", ["package://mine/meshes/base.STL", "mine/meshes/base.STL"])
def test_an_arm_is_drawn_with_the_meshes_of_its_packages(tmp_path, mesh):
    plant, scene_graph = AddMultibodyPlantSceneGraph(DiagramBuilder(), 0.0)
    AddArm(plant, load_arm(str(own_arm(tmp_path, mesh))))
    inspector = scene_graph.model_inspector()
    shapes = [inspector.GetShape(each) for each in inspector.GetAllGeometryIds(Role.kIllustration)]
    (drawn,) = (each for each in shapes if isinstance(each, Mesh))
    assert drawn.extension() == ".obj"
    hull = drawn.GetConvexHull()
    ends = np.array([hull.vertex(number) for number in range(hull.num_vertices())])
    np.testing.assert_allclose(ends.max(axis=0), [0.1, 0.2, 0.3], atol=1e-6)


def test_what_is_missing_is_named(tmp_path):
    path = own_arm(tmp_path, "package://mine/meshes/other.stl")
    with pytest.raises(ConfigurationError, match=r"other.stl: there is no such mesh"):
        load_arm(str(path))
    path.write_text(path.read_text().replace("mine: mine", "mine: nowhere"))
    with pytest.raises(ConfigurationError, match=r"packages.mine: there is no folder nowhere"):
        load_arm(str(path))
    path.write_text(path.read_text().replace("file: ", "file: package://other/"))
    path.write_text(path.read_text().replace("mine: nowhere", "mine: mine"))
    with pytest.raises(ConfigurationError, match=r"packages: \{other: path/of/it\}"):
        load_arm(str(path))
