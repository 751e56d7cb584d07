from __future__ import annotations

import hashlib
import io
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from mazebot.common.messages.documents import (
    Body,
    Box,
    Covering,
    Geometry,
    KeepoutZone,
    Mesh,
    Point2,
    Polyline,
    Room,
    Shape,
    SpeedZone,
)
from mazebot.common.world.geometry import TriangleMesh, triangles_of
from mazebot.common.world.marker_entities import marker_entities
from mazebot.worldgen.preview import (  # fmt: skip
    LEFT_PX,
    TOP_PX,
    draw_plan,
    material_colours,
    plan_png,
    view_of,
)
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_world
from mazebot.worldgen.world_model import world_glb


@pytest.fixture(scope="module")
def enhanced() -> LoadedWorld:
    return load_world("sim_house_enhanced")


@pytest.fixture(scope="module")
def furnished(enhanced: LoadedWorld) -> LoadedWorld:
    """The house with a covering, a red floor in a room, and a box that can be pushed."""
    walls = list(enhanced.world.walls)
    assert walls[0].name == "Wall_0"
    cover = Covering(side="left", from_m=-0.5, to_m=0.5, material="wood")
    walls[0] = walls[0].model_copy(update={"coverings": (cover,)})
    concrete = next(m for m in enhanced.world.materials if m.name == "concrete")
    red = concrete.model_copy(
        update={"name": "red", "texture_sha256": "", "diffuse": (1.0, 0.0, 0.0, 1.0)}
    )
    shape = Shape(name="s", geometry=Box(size_m=(0.4, 0.4, 0.4)), material="red")
    square = ((2.0, 2.0), (5.0, 2.0), (5.0, 3.0), (2.0, 3.0))
    world = enhanced.world.model_copy(
        update={
            "walls": tuple(walls),
            "materials": (*enhanced.world.materials, red),
            "bodies": (Body(name="b", position_m=(4.0, 0.0, 0.2), mass_kg=1.0, shapes=(shape,)),),
            "rooms": (Room(name="den", polygon_m=square, floor_material="red"),),
        }
    )
    return replace(enhanced, world=world)


class Plan:
    """A picture to ask for its colours at places of the map."""

    def __init__(self, loaded: LoadedWorld, seen: NDArray[np.bool_] | None = None) -> None:
        self.picture, self._view = draw_plan(loaded, seen), view_of(loaded)

    def at(self, x_m: float, y_m: float) -> list[int]:
        column, row = self._view.one(x_m, y_m)
        return [int(v) for v in self.picture[TOP_PX + int(row), LEFT_PX + int(column)]]


@pytest.fixture(scope="module")
def plain(enhanced: LoadedWorld) -> Plan:
    return Plan(enhanced, np.zeros((0, *enhanced.map_cells.shape), np.bool_))


@pytest.fixture(scope="module")
def full(furnished: LoadedWorld) -> Plan:
    return Plan(furnished, np.zeros((0, *furnished.map_cells.shape), np.bool_))


@pytest.fixture(scope="module")
def model(furnished: LoadedWorld) -> bytes:
    return world_glb(furnished)


def test_the_same_world_gives_the_same_model() -> None:
    loaded = load_world("sim_house_slam", overrides=("wall_materials=[red]", "rooms={}"))
    small = replace(loaded, assets={})
    assert world_glb(small) == world_glb(small)


def test_a_plan_is_a_png_of_at_most_2000_pixels_a_side(enhanced: LoadedWorld, plain: Plan) -> None:
    picture = cv2.imdecode(np.frombuffer(plan_png(enhanced), np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    again = draw_plan(enhanced)
    assert np.array_equal(picture[..., ::-1], again), "drawn anew, it is the same"
    # Unasked, it shows from where the markers can be read: from before marker 60, not behind it.
    column, row = (int(value) for value in view_of(enhanced).one(3.0, 2.2))
    assert again[TOP_PX + row, LEFT_PX + column].tolist() != plain.at(3.0, 2.2)
    assert 500 < max(picture.shape) <= 2000


def test_faces_have_the_mean_colours_of_their_materials(furnished: LoadedWorld, full: Plan) -> None:
    colours = material_colours(furnished.world, furnished.assets)
    assert colours["bricks"] == pytest.approx((143, 96, 94), abs=1)
    assert colours["red"] == (255, 0, 0)
    # Wall_0 runs along x at y = -2.034; its left face looks up.
    assert full.at(-2.0, -2.034 + 0.05) == list(colours["bricks"])
    assert full.at(-1.214, -2.034 + 0.05) == list(colours["wood"])
    assert full.at(-1.214, -2.034 - 0.05) == list(colours["bricks"])


def test_floor_rooms_bodies_and_the_unknown_differ(full: Plan) -> None:
    red, green, _ = full.at(3.7, 2.4)
    assert red > green + 60, "the room's floor is reddish"
    assert full.at(4.1, 0.1) == [255, 0, 0], "the box is as red as its material"
    outside, inside = full.at(-2.3, 4.2), full.at(-1.3, 1.7)
    assert outside == full.at(1.12, 2.2), "what is walled off is as the outside"
    assert np.abs(np.subtract(outside, inside)).max() > 10


def test_areas_are_tinted_in_their_markers_colours(enhanced: LoadedWorld, plain: Plan) -> None:
    seen: NDArray[np.bool_] = np.zeros((2, *enhanced.map_cells.shape), np.bool_)
    # Row 0 of the map is at its smallest y: tint what lies above 3 m, and right of 3 m.
    origin, resolution = enhanced.map_origin, enhanced.world.map_resolution_m
    seen[0, int((3.0 - origin.y_m) / resolution) :] = True
    seen[1, :, int((3.0 - origin.x_m) / resolution) :] = True
    tinted = Plan(enhanced, seen)
    above, right, both = (0.3, 3.7), (3.7, 0.3), (3.7, 3.2)
    assert tinted.at(-1.3, 1.7) == plain.at(-1.3, 1.7)
    colours = {tuple(plan.at(*place)) for plan in (plain, tinted) for place in (above, right)}
    assert len(colours) == 3, "one plain, two tinted"
    assert tuple(tinted.at(*both)) not in colours


ANGLE: tuple[Point2, ...] = ((0, 0), (1.2, 0), (1.2, 0.3), (0.3, 0.3), (0.3, 1.2), (0, 1.2))
"""Two arms of 0.3 m."""
IN_AN_ARM, IN_THE_ANGLE, ON_THE_DIAGONAL = (0.9, 0.15), (0.6, 0.6), (0.75, 0.75)
RED, INK = [255, 0, 0], 60


def angle_mesh(height_m: float = 1.0, keep_ends: bool = True) -> TriangleMesh:
    mesh = triangles_of(Polyline(polygons_m=(ANGLE,), height_m=height_m), {})
    upright = np.abs(mesh.normals[mesh.triangles[:, 0], 2]) < 0.5
    return replace(mesh, triangles=mesh.triangles[upright | keep_ends])


def plan_with(
    enhanced: LoadedWorld, mesh: TriangleMesh, z_m: float = 0.0, mass_kg: float = 0.0
) -> Plan:
    """The house without walls and markers, with a red mesh at (0, 0)."""
    red = enhanced.world.materials[0].model_copy(
        update={"name": "red", "texture_sha256": "", "diffuse": (1.0, 0.0, 0.0, 1.0)}
    )
    geometry: Geometry = Mesh(sha256="a" * 64)
    shape = Shape(name="s", geometry=geometry, material="red")
    body = Body(name="b", position_m=(0.0, 0.0, z_m), mass_kg=mass_kg, shapes=(shape,))
    update = {
        "materials": (*enhanced.world.materials, red),
        "bodies": (body,),
        "walls": (),
        "markers": (),
        "locations": (),
        "rooms": (),
    }
    world = enhanced.world.model_copy(update=update)
    loaded = replace(enhanced, world=world, meshes={"a" * 64: mesh})
    return Plan(loaded, np.zeros((0, *enhanced.map_cells.shape), np.bool_))


@pytest.mark.parametrize("mass_kg", [0.0, 1.0], ids=["static", "moving"])
@pytest.mark.parametrize("keep_ends", [True, False], ids=["closed", "without top and bottom"])
def test_a_mesh_is_filled_where_the_lidar_meets_it_and_nowhere_else(
    enhanced: LoadedWorld, keep_ends: bool, mass_kg: float
) -> None:
    plan = plan_with(enhanced, angle_mesh(keep_ends=keep_ends), mass_kg=mass_kg)
    assert plan.at(*IN_AN_ARM) == RED
    assert plan.at(0.15, 0.9) == RED
    floor = plan.at(*IN_THE_ANGLE)
    assert min(floor) > INK
    assert plan.at(*ON_THE_DIAGONAL) == floor, "no line from tip to tip"
    assert max(plan.at(0.9, 0.3)) <= INK, "an outline along the arm"


def test_what_the_lidar_looks_over_is_pale_and_what_it_looks_under_an_outline(
    enhanced: LoadedWorld,
) -> None:
    low, high = (plan_with(enhanced, angle_mesh(0.1), z_m) for z_m in (0.0, 1.0))
    red, green, blue = low.at(*IN_AN_ARM)
    assert red == 255
    assert 60 < green == blue < 200
    for plan in (low, high):
        assert plan.at(*IN_THE_ANGLE) == plan.at(*ON_THE_DIAGONAL) == high.at(*IN_AN_ARM)
        assert max(plan.at(0.9, 0.3)) <= INK


def test_a_flat_mesh_has_the_outline_that_it_covers(enhanced: LoadedWorld) -> None:
    mesh = angle_mesh()
    flat = replace(mesh, vertices_m=mesh.vertices_m * (1.0, 1.0, 0.0))
    plan = plan_with(enhanced, flat, z_m=0.5)
    assert plan.at(*ON_THE_DIAGONAL) == plan.at(*IN_THE_ANGLE)
    assert max(plan.at(0.9, 0.3)) <= INK


def test_a_room_of_thin_sheets_is_not_filled(enhanced: LoadedWorld) -> None:
    sheets = angle_mesh(keep_ends=False)
    inwards = replace(sheets, triangles=sheets.triangles[:, ::-1])
    both = replace(sheets, triangles=np.vstack([sheets.triangles, inwards.triangles]))
    for mesh in (inwards, both):
        plan = plan_with(enhanced, mesh)
        assert plan.at(*IN_AN_ARM) != RED
        assert plan.at(0.9, 0.3) == RED, "a line along the sheet"


def scene_of(model: bytes) -> trimesh.Scene:
    scene = trimesh.load_scene(io.BytesIO(model), file_type="glb")
    assert isinstance(scene, trimesh.Scene)
    return scene


def test_the_model_has_y_up_and_every_material(model: bytes) -> None:
    scene = scene_of(model)
    assert {"wall_bricks", "wall_wood", "wall_concrete", "floor_red", "body_red"} <= set(
        scene.geometry
    )
    walls: Any = scene.geometry["wall_bricks"]
    assert walls.bounds[:, 1] == pytest.approx([0.0, 3.0], abs=1e-5)
    assert walls.visual.material.baseColorTexture.size == (1024, 1024)
    box: Any = scene.geometry["body_red"]
    # x stays, the map's y is -z, its z is y.
    assert box.bounds == pytest.approx(np.array([[3.8, 0.0, -0.2], [4.2, 0.4, 0.2]]), abs=1e-5)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_the_model_holds_a_texture_as_the_file_that_it_is(
    furnished: LoadedWorld, suffix: str
) -> None:
    done, data = cv2.imencode(suffix, np.arange(48, dtype=np.uint8).reshape(4, 4, 3))
    assert done
    sha256 = hashlib.sha256(data.tobytes()).hexdigest()
    materials = tuple(
        material.model_copy(update={"texture_sha256": sha256})
        for material in furnished.world.materials
    )
    world = furnished.world.model_copy(update={"materials": materials})
    glb = world_glb(replace(furnished, world=world, assets={sha256: data.tobytes()}))
    assert data.tobytes() in glb
    walls: Any = scene_of(glb).geometry["wall_bricks"]
    assert walls.visual.material.baseColorTexture.size == (4, 4)


def test_markers_hang_in_the_model_the_right_way_up(enhanced: LoadedWorld, model: bytes) -> None:
    scene = scene_of(model)
    for entity in marker_entities(enhanced.world)[0].markers:
        panel: Any = scene.geometry[entity.name]
        x, y, z = entity.position_m
        assert panel.bounds.mean(0) == pytest.approx([x, z, -y], abs=1e-5)
        # trimesh's v runs upwards: the picture's top is at the panel's top.
        tops = panel.vertices[panel.visual.uv[:, 1] > 0.5]
        assert tops[:, 1] == pytest.approx(z + entity.panel_side_m / 2.0, abs=1e-5)
        # Both panels look along +x, glTF's +x as well: right is the map's +y, glTF's -z.
        rights = panel.vertices[panel.visual.uv[:, 0] > 0.5]
        assert rights[:, 2] == pytest.approx(-y - entity.panel_side_m / 2.0, abs=1e-5)
        assert panel.face_normals @ [1.0, 0.0, 0.0] == pytest.approx([1.0, 1.0], abs=1e-5)


def test_a_large_maze_has_a_legible_plan_of_bounded_size() -> None:
    maze = load_world("maze", overrides=("maze.rows=30", "maze.columns=30"))
    picture = draw_plan(maze)
    assert max(picture.shape) <= 2000
    assert view_of(maze).px_m > 50.0
    # Walls are drawn dark: along the outer wall every pixel is.
    wall = maze.world.walls[0]
    column, row = view_of(maze).one(wall.x_m, wall.y_m)
    assert picture[TOP_PX + int(row), LEFT_PX + int(column)].max() < 140


def test_a_floor_without_a_material_is_grey_in_the_model(enhanced: LoadedWorld) -> None:
    world = enhanced.world.model_copy(update={"floor_material": ""})
    scene: Any = trimesh.load(
        io.BytesIO(world_glb(replace(enhanced, world=world))), file_type="glb"
    )
    material = scene.geometry["floor_"].visual.material
    assert list(material.baseColorFactor[:3]) == [128, 128, 128]


def test_zones_are_hatched_in_their_colours(enhanced: LoadedWorld) -> None:
    square = ((2.2, 2.2), (3.2, 2.2), (3.2, 3.2), (2.2, 3.2))
    zones = {
        "keepout_zones": (KeepoutZone(name="carpet", polygon_m=square),),
        "speed_limits": (
            SpeedZone(name="hall", polygon_m=tuple((x + 1.2, y) for x, y in square), percent=30.0),
        ),
    }
    world = enhanced.world.model_copy(update=zones)
    none_seen = np.zeros((0, 0, 0), np.bool_)
    picture = draw_plan(replace(enhanced, world=world), none_seen).astype(int)
    red, green, blue = np.moveaxis(picture, 2, 0)
    view = view_of(enhanced)
    left, top = view.one(2.2, 3.2)
    side = view.px_m
    columns = np.arange(picture.shape[1])[None, :] - LEFT_PX - left
    rows = np.arange(picture.shape[0])[:, None] - TOP_PX - top
    inside = (columns > -2) & (columns < side + 2) & (rows > -2) & (rows < side + 2)
    keepout = (red > 180) & (green < 60) & (blue < 70)
    slow = (red > 180) & (abs(green - 110) < 15) & (blue < 20)
    assert (keepout & inside).sum() > 4 * side
    assert not (keepout & ~inside).any()
    assert slow.sum() > 4 * side
