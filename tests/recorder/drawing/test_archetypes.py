"""What is drawn where: each drawing against what its message says."""

from __future__ import annotations

import copy
import hashlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from mazebot.common.files.root import ROOT
from mazebot.common.maths.frames import SE2
from mazebot.common.messages import action_documents as act
from mazebot.common.messages import documents as doc
from mazebot.common.messages import messages as msg
from mazebot.common.messages import topics as table
from mazebot.common.messages.topics import read_by
from mazebot.common.world.geometry import mesh_to_bytes, triangles_of
from mazebot.recorder.drawing.archetypes import DRAW, SERIES, draw_nothing, draw_start
from mazebot.recorder.drawing.canvas import Canvas, Trail
from mazebot.recorder.drawing.layouts.layouts import run_blueprint
from mazebot.recorder.drawing.layouts.views import Scene
from mazebot.recorder.drawing.mesh import robot_from_urdf
from mazebot.recorder.drawing.scenery import extent_of
from mazebot.recorder.drawing.text_drawing import draw_evaluation
from mazebot.recorder.drawing.world_drawing import draw_world
from mazebot.recorder.stream.recording import Recording
from tests.common.samples import SAMPLES
from tests.recorder import synthetic
from tests.recorder.synthetic import BRICKS, ERROR_M, FOCAL_PX, Said, driving, opening, room

ROBOT = robot_from_urdf((ROOT / "models/turtlebot3_waffle/model.urdf").read_text())


class Paper:
    """Keeps what is drawn, in place of a Rerun recording."""

    def __init__(self) -> None:
        self.stamp_ns = 0
        self.logged: dict[str, list[Any]] = {}
        self.scalars: dict[str, list[tuple[int, float]]] = {}
        self.transforms: dict[str, list[tuple[int, tuple[float, ...], str, str]]] = {}
        self.hidden: dict[str, list[tuple[int, tuple[float, ...], str, str]]] = {}

    def at(self, stamp_ns: int) -> None:
        self.stamp_ns = stamp_ns

    def log(self, path: str, *archetypes: Any, static: bool = False) -> None:
        del static
        self.logged.setdefault(path, []).extend(archetypes)

    def log_later(self, path: str, make: Callable[[], Any], of: object = None) -> None:
        self.log(path, make())

    def scalar(self, path: str, value: float) -> None:
        self.scalars.setdefault(path, []).append((self.stamp_ns, value))

    def transform(
        self,
        path: str,
        translation_m: tuple[float, ...],
        _: object,
        parent: str,
        child: str,
        shown: bool = True,
    ) -> None:
        kept = self.transforms if shown else self.hidden
        kept.setdefault(path, []).append((self.stamp_ns, translation_m, parent, child))


def canvas_of(world: doc.World) -> tuple[Canvas, Paper]:
    paper = Paper()
    clock: Callable[[], float] = synthetic.WallClock(1.1)
    return Canvas(cast("Recording", paper), ROBOT, world, {}, clock), paper


def draw(canvas: Canvas, said: list[Said]) -> None:
    for now_ns, topic, message in said:
        canvas.now_ns = now_ns
        if topic is table.ASSETS:
            canvas.assets[message.header.frame_id] = message.data.tobytes()
        DRAW[topic](canvas, message)


def driven(seconds: float = 2.0) -> tuple[Canvas, Paper]:
    world = room()
    canvas, paper = canvas_of(world)
    draw_start(canvas)
    draw(canvas, opening(world))
    draw(canvas, list(driving(world, seconds)))
    return canvas, paper


def column(archetype: Any, name: str) -> Any:
    """A component's values."""
    return getattr(archetype, name).as_arrow_array()


def test_every_topic_that_the_recorder_reads_is_drawn() -> None:
    assert set(DRAW) == set(read_by("recorder"))


@pytest.mark.parametrize("topic", read_by("recorder"), ids=lambda topic: topic.name)
def test_one_message_of_each_topic_can_be_drawn(topic: Any) -> None:
    rr.set_strict_mode(True)
    canvas, paper = canvas_of(doc.World.model_validate(SAMPLES[table.WORLD].model_dump()))
    canvas.camera = SAMPLES[table.CAMERA_INFO]
    for _ in range(2):
        DRAW[topic](canvas, SAMPLES[topic])
    shown = paper.logged or paper.scalars or paper.transforms
    # A texture of nothing, entities of another world, a wheel that is none.
    nothing_to_show = topic in (table.ASSETS, table.ENTITIES, table.DESIRED_ENTITIES)
    nothing_to_show |= topic is table.JOINT_STATES
    # The model, the entities and the outline are drawn of other messages.
    nothing_to_show |= DRAW[topic] is draw_nothing
    assert shown or nothing_to_show


def test_every_plotted_entity_gets_numbers_and_a_name() -> None:
    _, paper = driven(3.0)
    by_service = {path for path in paper.scalars if path.startswith("performance/")}
    assert by_service == {"performance/lost/navigation", "performance/rejected/navigation"}
    by_a_person = {path for path in SERIES if path.startswith("cmd_vel_teleop/")}
    assert set(paper.scalars) - by_service == set(SERIES) - by_a_person


def test_errors_are_those_against_the_truth() -> None:
    _, paper = driven()
    values = [value for _, value in paper.scalars["error/localisation_m"]]
    assert values == pytest.approx([ERROR_M] * 20)
    assert paper.scalars["error/odometry_m"][-1][1] == pytest.approx(0.0, abs=1e-9)
    # The marker stands 2 m before the camera by its detections, whatever the robot's pose.
    truth = synthetic.true_pose(1_999_999_980)
    seen_at = (truth.matrix() @ synthetic.BASE_FROM_CAMERA @ np.array([2.0, 0.0, 0.0, 1.0]))[:3]
    expected_m = np.linalg.norm(seen_at - synthetic.marker_on_the_east_wall().position_m)
    assert paper.scalars["error/marker_m"][-1][1] == pytest.approx(float(expected_m), abs=1e-6)


def test_a_marker_is_outlined_where_the_camera_sees_it() -> None:
    _, paper = driven(0.2)
    outline = paper.logged["aruco/detections/outline"][-1]
    corners = np.array(column(outline, "strips").to_pylist()[0])
    half_px = FOCAL_PX * 0.15 / 2.0
    assert corners.min(axis=0) == pytest.approx([160 - half_px, 120 - half_px], abs=1e-3)
    assert corners.max(axis=0) == pytest.approx([160 + half_px, 120 + half_px], abs=1e-3)
    name = paper.logged["aruco/detections/outline/name"][-1]
    assert column(name, "labels").to_pylist() == ["id 60"]


def test_the_outline_goes_when_the_marker_does() -> None:
    canvas, paper = driven(0.2)
    empty = msg.Detection3DArray(msg.header(300_000_000, "camera_rgb_optical_frame"), [])
    for _ in range(3):
        DRAW[table.DETECTIONS](canvas, empty)
    outlines = [
        a
        for a in paper.logged["aruco/detections/outline"]
        if getattr(a, "strips", None) is not None
    ]
    assert len(column(outlines[-1], "strips")) == 0
    assert len(column(outlines[-2], "strips")) == 1  # told once


def test_the_picture_keeps_its_colours() -> None:
    import cv2

    _, paper = driven(0.2)
    (blob,) = column(paper.logged["camera/color/image_raw"][-1], "blob").to_pylist()
    picture = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    picture = picture.astype(int)
    assert picture[20, 20][::-1] == pytest.approx([30, 60, 200], abs=6)
    assert picture[220, 20][::-1] == pytest.approx([230, 200, 20], abs=6)


def test_echoes_lie_where_the_beams_point() -> None:
    _, paper = driven(0.2)
    points = np.array(column(paper.logged["scan"][-1], "positions").to_pylist())
    assert len(points) == 360 - len(range(0, 360, 7))  # those without an echo are left out
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(np.full(len(points), 1.5))
    first = np.arctan2(points[0, 1], points[0, 0])
    assert first == pytest.approx(np.pi / 180, abs=1e-4)


def test_a_grid_s_first_row_is_drawn_at_the_bottom() -> None:
    canvas, paper = canvas_of(room())
    cells = np.array([[100, 0], [-1, 0], [0, 50]], np.int8)
    grid = msg.occupancy_grid(0, 0.5, SE2(-3.0, 2.0, 0.0), cells)
    DRAW[table.MAP](canvas, grid)
    drawn = paper.logged["map"][-1]
    assert column(drawn, "data").to_pylist() == [[0, 50, 255, 0, 100, 0]]
    assert column(drawn, "translation").to_pylist()[0][:2] == [-3.0, 2.0]
    assert column(drawn, "cell_size").to_pylist() == [0.5]


def test_the_true_robot_moves_by_the_truth_and_the_other_by_the_estimate() -> None:
    _, paper = driven(1.0)
    stamp_ns, position_m, parent, child = paper.transforms["ground_truth/odom"][-1]
    truth = synthetic.true_pose(stamp_ns)
    assert position_m[:2] == pytest.approx((truth.x_m, truth.y_m))
    assert (parent, child) == ("map", "ground_truth")
    assert paper.transforms["tf/odom"][-1][1][0] == pytest.approx(ERROR_M)
    for name, frame in (
        ("ground_truth/robot", "ground_truth"),
        ("amcl_pose/robot", "base_footprint"),
    ):
        assert column(paper.logged[name][0], "frame").to_pylist() == [frame]


def test_walls_get_their_texture_when_it_comes_late() -> None:
    world = room()
    canvas, paper = canvas_of(world)
    draw_world(canvas, world)
    plain = paper.logged["world/walls/bricks"][-1]
    assert plain.albedo_texture_buffer is None
    asset = next(message for _, topic, message in opening(world) if topic is table.ASSETS)
    assert asset.header.frame_id == BRICKS
    draw(canvas, [(0, table.ASSETS, asset)] * 2)
    textured = [a for a in paper.logged["world/walls/bricks"] if isinstance(a, rr.Mesh3D)]
    assert len(textured) == 2  # the second copy of the asset changes nothing
    assert textured[-1].albedo_texture_buffer is not None
    positions = column(textured[-1], "vertex_positions")
    assert len(column(textured[-1], "vertex_texcoords")) == len(positions)


def furnished(**changes: Any) -> doc.World:
    """The room with a table top of a mesh, a ball that rolls, and all that a world can have."""
    world = room()
    table_top = doc.Body(
        name="table/top", position_m=(0.0, 0.5, 0.7),
        shapes=(doc.Shape(name="top", geometry=doc.Mesh(sha256=MESH), material="plain"),),
    )  # fmt: skip
    pillar = doc.Body(
        name="pillar", position_m=(1.0, -1.0, 1.5),
        shapes=(
            doc.Shape(
                name="shaft", geometry=doc.Cylinder(radius_m=0.2, length_m=3.0), material="bricks"
            ),
        ),
    )  # fmt: skip
    ball = doc.Body(
        name="ball", position_m=(-1.0, 0.0, 0.1), mass_kg=0.5,
        shapes=(doc.Shape(name="ball", geometry=doc.Sphere(radius_m=0.1), material="plain"),),
    )  # fmt: skip
    return world.model_copy(
        update={
            "bodies": (table_top, pillar, ball),
            "rooms": (
                doc.Room(
                    name="parlour",
                    polygon_m=((-2.0, -2.0), (0.0, -2.0), (0.0, 2.0), (-2.0, 2.0)),
                    floor_material="bricks",
                ),
            ),
            "ceiling": doc.Ceiling(height_m=3.0, material="plain"),
            "lights": (doc.PointLight(name="lamp", position_m=(0.0, 0.0, 2.5)),),
            **changes,
        }
    )


MESH_FILE = mesh_to_bytes(triangles_of(doc.Box(size_m=(0.8, 0.4, 0.02)), {}))
MESH = hashlib.sha256(MESH_FILE).hexdigest()


def mesh_asset() -> msg.CompressedImage:
    return msg.CompressedImage(msg.header(0, MESH), "npz", np.frombuffer(MESH_FILE, np.uint8))


def meshes_on(paper: Paper, path: str) -> list[Any]:
    return [a for a in paper.logged.get(path, []) if isinstance(a, rr.Mesh3D)]


def corners(mesh: Any) -> Any:
    return np.array(column(mesh, "vertex_positions").to_pylist())


def test_what_stands_is_cut_where_the_walls_are() -> None:
    rr.set_strict_mode(True)
    canvas, paper = canvas_of(furnished())
    canvas.assets[MESH] = MESH_FILE
    draw_world(canvas, canvas.world)
    for kind in ("walls", "bodies"):
        (below,) = meshes_on(paper, f"world/{kind}/bricks")
        (above,) = meshes_on(paper, f"world/{kind}_above/bricks")
        assert corners(below)[:, 2].max() == pytest.approx(1.0)
        assert corners(above)[:, 2].min() == pytest.approx(1.0)
        assert corners(above)[:, 2].max() == pytest.approx(3.0)
    (lid,) = meshes_on(paper, "world/walls/plain/top")
    assert set(corners(lid)[:, 2]) == {1.0}
    (inside,) = meshes_on(paper, "world/bodies/bricks/top")
    assert corners(inside).min(axis=0) == pytest.approx([0.8, -1.2, 1.0], abs=1e-3)
    assert corners(inside).max(axis=0) == pytest.approx([1.2, -0.8, 1.0], abs=1e-3)
    (top,) = meshes_on(paper, "world/bodies/plain")
    assert corners(top).min(axis=0) == pytest.approx([-0.4, 0.3, 0.69], abs=1e-5)
    (ceiling,) = meshes_on(paper, "world/ceiling")
    assert set(corners(ceiling)[:, 2]) == {3.0}


def test_a_low_wall_has_a_top_and_no_upper_part() -> None:
    world = room(height_m=0.8)
    canvas, paper = canvas_of(world)
    draw_world(canvas, world)
    (top,) = meshes_on(paper, "world/walls/bricks/top")
    assert set(corners(top)[:, 2]) == {np.float64(np.float32(0.8))}
    assert not [path for path in paper.logged if "above" in path]


def test_the_floor_reaches_a_little_beyond_the_walls_and_lies_under_the_map() -> None:
    canvas, paper = canvas_of(furnished(bodies=()))
    draw_world(canvas, canvas.world)
    (floor,) = meshes_on(paper, "world/floor")
    (parlour,) = meshes_on(paper, "world/rooms/parlour/floor")
    assert corners(floor).min(axis=0) == pytest.approx([-2.875, -2.875, -0.01], abs=1e-3)
    assert corners(floor).max(axis=0) == pytest.approx([2.875, 2.875, -0.01], abs=1e-3)
    assert corners(parlour)[:, :2].max(axis=0) == pytest.approx([0.0, 2.0], abs=1e-5)
    (outline,) = [a for a in paper.logged["world/rooms"] if isinstance(a, rr.LineStrips3D)]
    assert len(column(outline, "strips").to_pylist()) == 1
    (names,) = [a for a in paper.logged["world/rooms/names"] if isinstance(a, rr.Points3D)]
    assert column(names, "labels").to_pylist() == ["parlour"]
    (lamps,) = [a for a in paper.logged["world/lights"] if isinstance(a, rr.Points3D)]
    assert column(lamps, "positions").to_pylist() == [[0.0, 0.0, 2.5]]


def test_zones_are_outlined_with_what_they_say() -> None:
    square = ((0.0, 0.0), (0.5, 0.0), (0.5, 0.5))
    zones = {
        "keepout_zones": (doc.KeepoutZone(name="carpet", polygon_m=square),),
        "speed_limits": (
            doc.SpeedZone(name="hall", polygon_m=square, speed_limit_m_s=0.15),
            doc.SpeedZone(name="door", polygon_m=square, percent=30.0),
        ),
    }
    canvas, paper = canvas_of(furnished(**zones))
    draw_world(canvas, canvas.world)
    (outlines,) = [a for a in paper.logged["world/zones"] if isinstance(a, rr.LineStrips3D)]
    assert len(column(outlines, "strips").to_pylist()) == 3
    (names,) = [a for a in paper.logged["world/zones/names"] if isinstance(a, rr.Points3D)]
    told = column(names, "labels").to_pylist()
    assert told == ["keepout: carpet", "0.15 m/s: hall", "30 %: door"]
    canvas, paper = canvas_of(furnished())
    draw_world(canvas, canvas.world)
    assert "world/zones" not in paper.logged


def test_what_moves_is_drawn_once_in_a_frame_of_its_own() -> None:
    canvas, paper = canvas_of(furnished())
    draw_world(canvas, canvas.world)
    (ball,) = meshes_on(paper, "world/moving/ball/plain")
    assert np.abs(corners(ball)).max() == pytest.approx(0.1, abs=1e-6)
    frame = paper.logged["world/moving/ball/plain"][0]
    assert column(frame, "frame").to_pylist() == ["ball"]
    matrix = SE2(-0.5, 0.2, 0.0).matrix()
    told = msg.TFMessage([msg.transform_stamped(1_000, "map", "ball", matrix)])
    DRAW[table.TF](canvas, told)
    assert [row[1][:2] for row in paper.transforms["tf/ball"]] == [(-1.0, 0.0), (-0.5, 0.2)]
    assert len(meshes_on(paper, "world/moving/ball/plain")) == 1


def test_a_body_whose_mesh_comes_late_is_drawn_then() -> None:
    canvas, paper = canvas_of(furnished())
    draw_world(canvas, canvas.world)
    assert not meshes_on(paper, "world/bodies/plain")
    draw(canvas, [(0, table.ASSETS, mesh_asset())] * 2)
    assert len(meshes_on(paper, "world/bodies/plain")) == 1


def test_names_of_any_letters_are_one_part_of_a_path(tmp_path: Path) -> None:
    rr.set_strict_mode(True)
    body = furnished().bodies[1].model_copy(update={"name": "a::b c/d", "mass_kg": 1.0})
    canvas, paper = canvas_of(furnished(bodies=(body,)))
    draw_world(canvas, canvas.world)
    (path,) = [path for path in paper.logged if path.startswith("world/moving")]
    stream = rr.RecordingStream("test")
    stream.save(tmp_path / "x.rrd")
    stream.log(path, rr.TextLog("there"))
    stream.disconnect()
    assert len(rr_path_parts(path)) == 4


def rr_path_parts(path: str) -> list[str]:
    return re.split(r"(?<!\\)/", path)


def test_a_marker_that_is_taken_away_is_drawn_no_more() -> None:
    world = room()
    canvas, paper = driven(0.2)
    canvas.now_ns = 500_000_000
    DRAW[table.ENTITIES](canvas, doc.Entities(world_hash=world.hash))
    (row,) = paper.hidden["entities/marker_60"]
    assert (row[0], *row[2:]) == (500_000_000, "map", "entities/marker_60")


def test_entities_of_another_world_are_not_drawn() -> None:
    canvas, paper = canvas_of(room())
    entity = synthetic.marker_on_the_east_wall()
    DRAW[table.ENTITIES](canvas, doc.Entities(world_hash="other", entities=(entity,)))
    assert not [path for path in paper.logged if path.startswith("entities/marker_60")]


def crate(name: str = "crate", **changes: Any) -> doc.BodyEntity:
    """A box of 40 cm on the floor, with a handle of another material."""
    fields: dict[str, Any] = {
        "name": name,
        "position_m": (1.0, 0.5, 0.2),
        "shapes": (
            doc.Shape(name="box", geometry=doc.Box(size_m=(0.4, 0.4, 0.4)), material="wood"),
            doc.Shape(name="handle", geometry=doc.Sphere(radius_m=0.05), material="iron"),
        ),
        "materials": (
            doc.Material(name="wood", texture_sha256=BRICKS),
            doc.Material(name="iron", diffuse=(1.0, 0.0, 0.0, 1.0)),
        ),
    }
    return doc.BodyEntity(**{**fields, **changes})


def stand(canvas: Canvas, now_s: float, *entities: doc.Entity) -> None:
    canvas.now_ns = round(now_s * 1e9)
    told = doc.Entities(world_hash=canvas.world.hash, entities=entities)
    DRAW[table.ENTITIES](canvas, told)


def test_what_is_spawned_is_seen_from_then_until_it_is_taken_away() -> None:
    rr.set_strict_mode(True)
    canvas, paper = canvas_of(room())
    stand(canvas, 0.0)
    stand(canvas, 2.0, crate())
    (wood,) = meshes_on(paper, "entities/crate/wood")
    assert corners(wood).max() == pytest.approx(0.2)
    (iron,) = meshes_on(paper, "entities/crate/iron")
    assert column(iron, "albedo_factor").to_pylist() == [0xFF0000FF]
    frame = paper.logged["entities/crate/wood"][0]
    assert column(frame, "frame").to_pylist() == ["entities/crate"]
    assert [row[0] for row in paper.hidden["entities/crate"]] == [0]
    assert paper.transforms["entities/crate"] == [
        (2_000_000_000, (1.0, 0.5, 0.2), "map", "entities/crate")
    ]
    stand(canvas, 3.0, crate(position_m=(-1.0, 0.0, 0.2)))
    stand(canvas, 4.0)
    stand(canvas, 5.0, crate())
    assert [row[0] for row in paper.hidden["entities/crate"]] == [0, 4_000_000_000]
    assert [row[1][0] for row in paper.transforms["entities/crate"]] == [1.0, -1.0, 1.0]
    assert len(meshes_on(paper, "entities/crate/wood")) == 1


def test_what_moves_hangs_on_the_frame_of_its_name() -> None:
    canvas, paper = canvas_of(room())
    stand(canvas, 0.0, crate(mass_kg=1.0))
    frame = paper.logged["entities/crate/wood"][0]
    assert column(frame, "frame").to_pylist() == ["crate"]
    matrix = SE2(-0.5, 0.2, 0.0).matrix()
    told = msg.TFMessage([msg.transform_stamped(1_000, "map", "crate", matrix)])
    DRAW[table.TF](canvas, told)
    assert [row[1][0] for row in paper.transforms["tf/crate"]] == [1.0, -0.5]
    stand(canvas, 1.0, crate())  # put back, and held
    assert [row[0] for row in paper.hidden["tf/crate"]] == [1_000_000_000]
    frames = [a for a in paper.logged["entities/crate/wood"] if isinstance(a, rr.CoordinateFrame)]
    assert column(frames[-1], "frame").to_pylist() == ["entities/crate"]


def test_another_thing_of_the_same_name_leaves_nothing_of_the_first() -> None:
    canvas, paper = canvas_of(room())
    stand(canvas, 0.0, crate())
    stand(canvas, 1.0, crate(shapes=crate().shapes[1:]))
    assert len(corners(meshes_on(paper, "entities/crate/wood")[-1])) == 0
    assert len(corners(meshes_on(paper, "entities/crate/iron")[-1])) > 0


def test_a_spawned_thing_is_drawn_when_its_mesh_and_texture_have_come() -> None:
    shape = doc.Shape(name="top", geometry=doc.Mesh(sha256=MESH), material="wood")
    canvas, paper = canvas_of(room())
    stand(canvas, 0.0, crate(shapes=(shape,)))
    assert not meshes_on(paper, "entities/crate/wood")
    texture = next(message for _, topic, message in opening(room()) if topic is table.ASSETS)
    draw(canvas, [(0, table.ASSETS, mesh_asset()), (0, table.ASSETS, texture)])
    plain, textured = meshes_on(paper, "entities/crate/wood")
    assert plain.albedo_texture_buffer is None
    assert textured.albedo_texture_buffer is not None


def test_where_still_things_are_is_told_again_for_viewers_that_come_late() -> None:
    canvas, paper = canvas_of(room())
    stand(canvas, 0.0, crate(), crate("ball", mass_kg=1.0))
    for second in range(31):
        canvas.now_ns = second * 1_000_000_000
        DRAW[table.CLOCK](canvas, msg.Clock(msg.time_from_ns(canvas.now_ns)))
    times_s = [row[0] * 1e-9 for row in paper.transforms["entities/crate"]]
    assert times_s == pytest.approx([0.0, 0.0, 10.0, 20.0, 30.0])
    assert len(paper.transforms["tf/ball"]) == 1


def test_how_many_entities_should_stand_is_kept_when_it_changes() -> None:
    canvas, paper = canvas_of(room())
    entities = tuple(crate(f"crate_{number}") for number in range(100))
    told = doc.Entities(world_hash=canvas.world.hash, entities=entities)
    for _ in range(2):
        DRAW[table.DESIRED_ENTITIES](canvas, told)
    (kept,) = paper.logged["entities/desired"]
    counts = {
        str(b.component_descriptor()): b.as_arrow_array() for b in kept.as_component_batches()
    }
    assert [c.to_pylist() for c in counts.values()] == [[100], [0]]


def test_the_log_holds_what_services_print_and_says_nothing_of_it_again() -> None:
    canvas, paper = driven(2.0)
    stand(canvas, 3.0, crate())
    stand(canvas, 4.0)
    samples = (table.CONTACTS, table.INITIAL_POSE, table.WORLD_REQUEST, table.WORLD_STATUS)
    for topic in samples:
        DRAW[topic](canvas, SAMPLES[topic])
    told = {
        path.split("/")[0]
        for path, logged in paper.logged.items()
        if any(isinstance(one, rr.TextLog) for one in logged)
    }
    # What draws the camera's images is printed before anybody listens.
    assert told == {"rosout", "diagnostics", "simulation", "events"}


def test_where_no_marker_is_seen_the_line_of_its_error_has_a_gap() -> None:
    canvas, paper = driven(0.2)
    assert not [a for a in paper.logged.get("error/marker_m", []) if isinstance(a, rr.Clear)]
    seen = len(paper.scalars["error/marker_m"])
    for stamp_ns in (300_000_000, 400_000_000):
        header = msg.header(stamp_ns, "camera_rgb_optical_frame")
        DRAW[table.DETECTIONS](canvas, msg.Detection3DArray(header, []))
    assert len(paper.scalars["error/marker_m"]) == seen
    gaps = [a for a in paper.logged["error/marker_m"] if isinstance(a, rr.Clear)]
    assert len(gaps) == 1


def test_without_a_goal_there_is_no_distance_to_it() -> None:
    canvas, paper = driven(2.0)
    path = "navigation/status/distance_remaining_m"
    before = len(paper.scalars[path])
    idle = doc.NavigationStatus(localization_active=True, navigation_active=True)
    DRAW[table.NAVIGATION_STATUS](canvas, idle)
    assert len(paper.scalars[path]) == before
    assert isinstance(paper.logged[path][-1], rr.Clear)


def test_the_costmap_lies_on_the_map_and_leaves_its_opacity_to_the_view() -> None:
    _, paper = driven(0.2)
    (grid,) = (a for a in paper.logged["map"] if isinstance(a, rr.GridMap))
    (costmap,) = (a for a in paper.logged["global_costmap/costmap"] if isinstance(a, rr.GridMap))
    assert column(costmap, "draw_order").to_pylist() > column(grid, "draw_order").to_pylist()
    assert costmap.opacity is None


def test_the_true_robot_has_its_shape_and_the_estimate_is_an_outline() -> None:
    _, paper = driven(0.2)
    assert meshes_on(paper, "ground_truth/robot")
    assert meshes_on(paper, "ground_truth/robot/wheel_left_joint")
    drawn = paper.logged["amcl_pose/robot"]
    assert [type(one) for one in drawn] == [rr.CoordinateFrame, rr.LineStrips3D]


def report(name: str, **changes: Any) -> doc.GoalReport:
    fields: dict[str, Any] = {
        "name": name, "reached": True, "time_s": 7.6, "path_length_m": 2.014,
        "shortest_path_m": None, "goal_error_m": 0.0368, "goal_error_rad": 0.1, "recoveries": 0,
        "error_code": 0,
    }  # fmt: skip
    return doc.GoalReport(**{**fields, **changes})


def results_of(paper: Paper) -> list[str]:
    return [column(one, "text").to_pylist()[0] for one in paper.logged["evaluation"]]


def test_the_table_of_the_tour_is_drawn_anew_when_a_goal_ends() -> None:
    canvas, paper = canvas_of(room())
    for goals in ((), (), (report("a_b|c"),), (report("a_b|c"), report("d", reached=False))):
        draw_evaluation(canvas, doc.Evaluation(goals=goals))
    empty, one, two = results_of(paper)
    assert "No goal yet" in empty
    assert "no estimate" in one
    assert r"| a\_b\|c | yes | 7.6 | 2.01 | - | - | 0.037 | 5.7 | 0 | 0 |" in one.splitlines()
    assert two.splitlines()[0] == "# 1 of 2 goals reached"
    draw_evaluation(canvas, doc.Evaluation(goals=(report("a"),) * 1000), final=True)
    text = results_of(paper)[-1]
    assert text.count("| a |") == 50
    assert "950 earlier goals" in text


def test_a_behaviour_tree_is_indented_and_marked() -> None:
    canvas, paper = canvas_of(room())
    DRAW[table.BEHAVIOR_TREE](canvas, SAMPLES[table.BEHAVIOR_TREE])
    DRAW[table.BEHAVIOR_TREE](canvas, act.BehaviorTreeLog())
    first, last = (column(one, "text").to_pylist()[0] for one in paper.logged["behavior_tree"])
    lines = first.splitlines()
    assert lines[0] == "# navigate to pose"
    assert lines[3:5] == ["▶ RecoveryNode 'NavigateRecovery'", "✖   FollowPath"]
    assert last.startswith("# no action\n")


def test_rollouts_are_drawn_in_their_own_colours() -> None:
    canvas, paper = canvas_of(room())
    DRAW[table.TRAJECTORIES](canvas, SAMPLES[table.TRAJECTORIES])
    DRAW[table.TRAJECTORIES](canvas, msg.marker_array([]))
    (drawn,) = (one for one in paper.logged["trajectories"] if isinstance(one, rr.LineStrips3D))
    assert column(drawn, "strips").to_pylist() == [
        [pytest.approx([0.0, 0.0, 0.1]), pytest.approx([1.0, 0.5, 0.1])]
    ]
    assert column(drawn, "colors").to_pylist() == [0xFF8000FF]
    assert column(drawn, "radii").to_pylist() == pytest.approx([0.005])


def test_a_rollout_without_points_is_none() -> None:
    rr.set_strict_mode(True)
    canvas, paper = canvas_of(room())
    array = copy.deepcopy(SAMPLES[table.TRAJECTORIES])
    array.markers[0].points = []
    DRAW[table.TRAJECTORIES](canvas, array)
    (drawn,) = (one for one in paper.logged["trajectories"] if isinstance(one, rr.LineStrips3D))
    assert column(drawn, "strips").to_pylist() == [[]]


def test_an_action_s_goal_is_shown_while_it_is_driven_to_and_by_its_end() -> None:
    canvas, paper = canvas_of(room())
    goal = doc.Planar(x_m=1.0, y_m=2.0, yaw_rad=0.0)
    going = act.ActionFeedback(goal_id="a", action="dock_robot", goal=goal)
    DRAW[table.ACTION_FEEDBACK](canvas, going)
    DRAW[table.ACTION_FEEDBACK](canvas, going)
    ended = {"goal_id": "a", "action": "dock_robot", "start_time_s": 0.0, "end_time_s": 1.0}
    failed = act.ActionResult(**ended, status="aborted", error_code=902, goal=goal)
    DRAW[table.ACTION_RESULT](canvas, failed)
    arrows = [one for one in paper.logged["goal_pose"] if isinstance(one, rr.Arrows3D)]
    colors = [column(arrow, "colors").to_pylist()[0] >> 8 for arrow in arrows]
    assert colors == [0x3498FF, 0xE74C3C]


def test_a_trail_keeps_a_point_every_three_centimetres_and_a_bounded_number() -> None:
    trail = Trail()
    taken = [trail.add(0.0101 * i, 0.0) for i in range(100_000)]
    assert sum(taken[:31]) == 11
    assert len(trail.points(0.0)) == 4000
    assert trail.points(0.5)[-1] == pytest.approx([1009.99, 0.0, 0.5], abs=0.04)


def test_the_layout_looks_into_the_maze_from_outside_and_above() -> None:
    rr.set_strict_mode(True)
    for world in (room(), room().model_copy(update={"walls": (), "locations": ()})):
        extent = extent_of(world, {})
        assert run_blueprint(Scene(extent)) is not None


def views_in(part: Any) -> dict[str, Any]:
    """The views of a layout by their names."""
    if not isinstance(part, rrb.Container):
        return {str(part.name): part}
    return {name: view for one in part.contents for name, view in views_in(one).items()}


def test_x_is_to_the_right_and_y_up_on_the_map() -> None:
    views = views_in(run_blueprint(Scene(extent_of(room(), {}))).root_container)
    for name in ("Maze", "Map"):
        eye = views[name].properties["EyeControls3D"]
        position, target, up = (
            np.array(column(eye, part).to_pylist()[0])
            for part in ("position", "look_target", "eye_up")
        )
        forward = (target - position) / np.linalg.norm(target - position)
        right = np.cross(forward, up)
        assert right / np.linalg.norm(right) == pytest.approx([1.0, 0.0, 0.0])
        assert np.cross(right, forward)[1] > 0.0
        # Nearer to straight down than this, Rerun takes another direction for up.
        assert abs(forward @ up) < np.sin(np.radians(89.0))
    assert column(views["Map"].properties["EyeControls3D"], "position").to_pylist()[0][0] == 0.0


def test_plots_and_states_show_the_whole_run() -> None:
    views = views_in(run_blueprint(Scene(extent_of(room(), {}))).root_container)
    lines = [view for view in views.values() if isinstance(view, rrb.TimeSeriesView)]
    assert len(lines) == 10
    for view in (*lines, views["States"]):
        (span,) = column(view.properties["TimeAxis"], "view_range").to_pylist()
        assert span == {"start": None, "end": None}


def depth_image(stamp_ns: int, depth_m: Any, **fields: Any) -> msg.Image:
    height, width = depth_m.shape
    header = msg.header(stamp_ns, "camera_rgb_optical_frame")
    values = {"encoding": "32FC1", "step": 4 * width, **fields}
    data = depth_m.astype(np.float32).reshape(-1).view(np.uint8)
    return msg.Image(
        header, height, width, values["encoding"], 0, values["step"], data
    )  # fmt: skip


def test_depths_are_drawn_twice_a_second_in_millimetres() -> None:
    import cv2

    rr.set_strict_mode(True)
    canvas, paper = canvas_of(room())
    depth_m = np.array([[0.0, 0.1234, 9.9996], [np.inf, np.nan, 70.0]])
    for frame in range(11):
        DRAW[table.DEPTH_IMAGE](canvas, depth_image(frame * 100_000_000, depth_m))
    drawn = [
        a
        for a in paper.logged["camera/depth/image_rect_raw"]
        if isinstance(a, rr.EncodedDepthImage)
    ]
    assert len(drawn) == 3
    (blob,) = column(drawn[0], "blob").to_pylist()
    millimetres = cv2.imdecode(np.array(blob, np.uint8), cv2.IMREAD_UNCHANGED)
    assert millimetres is not None
    assert millimetres.tolist() == [[0, 123, 10000], [0, 0, 65535]]
    assert column(drawn[0], "meter").to_pylist() == [1000.0]


@pytest.mark.parametrize("fields", [{"encoding": "16UC1"}, {"step": 8}])
def test_depths_that_are_none_are_told_of_once(fields: dict[str, Any]) -> None:
    canvas, paper = canvas_of(room())
    for frame in range(3):
        image = depth_image(frame * 1_000_000_000, np.ones((2, 3)), **fields)
        DRAW[table.DEPTH_IMAGE](canvas, image)
    (told,) = paper.logged["camera/depth/image_rect_raw"]
    assert isinstance(told, rr.TextLog)


def test_a_picture_that_comes_as_jpeg_is_drawn_as_it_came() -> None:
    canvas, paper = driven(0.2)
    jpeg = np.frombuffer(b"a jpeg", np.uint8)
    header = msg.header(300_000_000, "camera_rgb_optical_frame")
    DRAW[table.CAMERA_COMPRESSED](canvas, msg.CompressedImage(header, "jpeg", jpeg))
    (blob,) = column(paper.logged["camera/color/image_raw"][-1], "blob").to_pylist()
    assert bytes(blob) == b"a jpeg"
    before = len(paper.logged["camera/color/image_raw"])
    picture = next(m for _, topic, m in driving(room(), 0.2) if topic is table.CAMERA_IMAGE)
    DRAW[table.CAMERA_IMAGE](canvas, picture)
    assert len(paper.logged["camera/color/image_raw"]) == before
