from __future__ import annotations

from pathlib import Path

import numpy as np

from mazebot.common.messages import documents as doc
from mazebot.worldgen.recipe_model import GeometryRecipe, MeshGeometry
from mazebot.worldgen.sdf.model import SdfWorld
from mazebot.worldgen.sdf.reading.read import read_sdf

BOX = "<box><size>1 1 1</size></box>"
TURNED = "<pose>0.5 0 0 0 0 1.5707963267948966</pose>"


def shape(inside: str, name: str = "c", role: str = "collision", pose: str = "") -> str:
    return f'<{role} name="{name}">{pose}<geometry>{inside}</geometry></{role}>'


def model(name: str, inside: str) -> str:
    return f'<model name="{name}"><static>1</static>{inside}</model>'


def read(where: Path, models: str, state: str) -> SdfWorld:
    file = where / "hall.world"
    file.write_text(
        f'<sdf version="1.7"><world name="w">{models}<state world_name="w">{state}</state>'
        "</world></sdf>"
    )
    world = read_sdf(file)
    assert world.report.errors == ()
    return world


def geometries(world: SdfWorld) -> dict[str, GeometryRecipe]:
    return {shape.name: shape.geometry for link in world.links for shape in link.shapes}


def test_a_saved_scale_is_that_of_the_shapes_of_a_models_own_links(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("")
    kinds = {
        "box": BOX,
        "ball": "<sphere><radius>0.5</radius></sphere>",
        "drum": "<cylinder><radius>0.5</radius><length>1</length></cylinder>",
        "mesh": "<mesh><uri>a.obj</uri><scale>0.1 0.1 0.1</scale></mesh>",
    }
    shapes = "".join(shape(inside, name) for name, inside in kinds.items())
    inner = model("inner", f'<link name="l">{shape(BOX, "in")}</link>')
    world = read(
        tmp_path,
        model("outer", f'<link name="l"><pose>1 0 0 0 0 0</pose>{shapes}</link>{inner}'),
        """<model name="outer"><pose>0 0 0 0 0 0</pose><scale>4 2 3</scale>
        <model name="inner"><pose>0 0 0 0 0 0</pose></model></model>""",
    )
    found = geometries(world)
    assert found["box"] == doc.Box(size_m=(4.0, 2.0, 3.0))
    assert found["ball"] == doc.Sphere(radius_m=2.0)
    assert found["drum"] == doc.Cylinder(radius_m=2.0, length_m=3.0)
    assert isinstance(found["mesh"], MeshGeometry)
    np.testing.assert_allclose(found["mesh"].scale, (0.4, 0.2, 0.3))
    assert found["in"] == doc.Box(size_m=(1.0, 1.0, 1.0))
    # Poses are not scaled.
    np.testing.assert_allclose(world.links[0].world_from_link[:3, 3], (1.0, 0.0, 0.0))


def test_a_saved_scale_is_along_the_axes_of_each_shape(tmp_path: Path) -> None:
    shapes = shape(BOX, "c", pose=TURNED) + shape(BOX, "v", "visual", TURNED)
    world = read(
        tmp_path,
        model("m", f'<link name="l">{shapes}</link>'),
        '<model name="m"><scale>4 0.2 1</scale></model>',
    )
    assert set(geometries(world).values()) == {doc.Box(size_m=(4.0, 0.2, 1.0))}
    for one in world.links[0].shapes:
        np.testing.assert_allclose(one.link_from_shape[:3, 3], (0.5, 0.0, 0.0))


def test_what_a_saved_scale_leaves_as_it_is_is_a_warning(tmp_path: Path) -> None:
    points = "".join(f"<point>{at}</point>" for at in ("0 0", "1 0", "0 1"))
    prism = f"<polyline>{points}<height>1</height></polyline>"
    world = read(
        tmp_path,
        model("m", f'<link name="l">{shape(prism)}</link>'),
        '<model name="m"><scale>2 1 1</scale></model>',
    )
    (warning,) = world.report.warnings()
    assert "scale 2 1 1 of a polyline" in warning
    assert "hall.world:1: world w/model m/link l/collision c" in warning
