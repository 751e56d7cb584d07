"""A recipe that has every kind of thing, and how a world goes to SDF and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import trimesh
from lxml import etree

from mazebot.common.messages.documents import World
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.recipe.loader import load_file
from mazebot.worldgen.sdf.convert import to_recipe
from mazebot.worldgen.sdf.export import export_files, export_world
from mazebot.worldgen.sdf.reading.read import read_sdf
from mazebot.worldgen.sdf.recipe_file import ImportedWorld, recipe_yaml, write_recipe
from tests.worldgen import folder

TILTED = [0.18257418583505536, 0.3651483716701107, 0.5477225575051661, 0.7302967433402214]


def shape(name: str, geometry: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"name": name, "geometry": geometry, "material": "paint", **more}


def recipe() -> dict[str, Any]:
    """Walls with coverings, bodies of every geometry, rooms, ceiling, lamps and markers."""
    outline = [[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]]
    hole = [[0.1, 0.1], [0.3, 0.1], [0.3, 0.2], [0.1, 0.2]]
    made = folder.room()
    made["name"] = "everything"
    made["materials"]["paint"] = {
        "diffuse": [0.1, 0.2, 0.3, 1.0], "texture_side_m": 0.25, "texture": "other.png",
    }  # fmt: skip
    made["materials"]["tiles"] = {"diffuse": [0.9, 0.9, 1 / 3, 1.0], "texture_side_m": 0.0}
    made["floor_material"] = "tiles"
    made["ceiling"] = {"material": "paint", "height_m": 2.6 + 1 / 300}
    made["rooms"] = {
        "left": {
            "polygon_m": [[-2.0, -1.0], [0.0, -1.0], [0.0, 1.0], [-2.0, 1.0]],
            "wall_material": "paint", "floor_material": "brick",
        },
        "right": {"polygon_m": [[0.0, -1.0], [2.0, -1.0], [2.0, 1.0], [0.0, 1.0]]},
    }  # fmt: skip
    made["walls"][1]["thickness_m"] = 0.2
    made["walls"].append(
        {"name": "post", "length_m": 0.1, "thickness_m": 0.3, "height_m": 1 / 3, "x_m": 1.7,
         "y_m": 0.7, "yaw_rad": 2.0, "material": "tiles",
         "coverings": [{"side": "right", "from_m": -0.05, "to_m": 0.02, "material": "brick"}]}
    )  # fmt: skip
    made["markers"].append(
        {"id": 9, "wall": "north", "side": "left", "offset_m": -1 / 3, "height_m": 0.41,
         "size_m": 0.2, "dictionary": "DICT_6X6_250", "quiet_zone_modules": 2}
    )  # fmt: skip
    # The spawner refuses these two: they stay what they are.
    made["markers"].append(
        {"id": 3, "wall": "west", "side": "right", "offset_m": 0.0, "height_m": 0.5}
    )
    made["markers"].append(
        {"id": 4, "wall": "west", "side": "right", "offset_m": 0.9, "height_m": 0.5}
    )
    made["sky"] = [0.5, 0.6, 0.7, 1.0]
    made["light"] = {"direction": [0.3, -0.2, -2.0], "ambient": 0.55, "diffuse": 0.65}
    made["lights"] = [
        {"name": "lamp", "position_m": [0.5, -0.25, 2.5], "diffuse": [1.0, 0.9, 0.8, 1.0],
         "range_m": 7.5, "constant": 0.3, "linear": 0.2, "quadratic": 0.05},
        {"name": "sun", "position_m": [-0.5, 1 / 3, 2.5]},
    ]  # fmt: skip
    made["bodies"] = [
        {
            "name": "table::of world", "position_m": [1.2, 0.0, 0.1],
            "orientation_xyzw": TILTED,
            "shapes": [
                shape("box", {"kind": "box", "size_m": [0.1, 0.2, 0.3]}),
                shape("rod", {"kind": "cylinder", "radius_m": 0.02, "length_m": 0.5},
                      position_m=[0.0, 0.1, 1 / 7], orientation_xyzw=TILTED, solid=False),
                {**shape("felt", {"kind": "sphere", "radius_m": 0.05}), "material": None},
                {**shape("ghost", {"kind": "sphere", "radius_m": 0.05}), "material": None,
                 "solid": False},
                shape("tip", {"kind": "cone", "radius_m": 0.05, "length_m": 0.2}),
                shape("pill", {"kind": "capsule", "radius_m": 0.03, "length_m": 0.1}),
                shape("egg", {"kind": "ellipsoid", "radii_m": [0.03, 0.04, 0.05]}),
                shape("sheet", {"kind": "plane", "size_m": [0.2, 0.3]}, orientation_xyzw=TILTED),
                shape("print", {"kind": "plane", "size_m": [0.2, 0.3]}, solid=False),
                shape("frame", {"kind": "polyline", "polygons_m": [outline, hole],
                                "height_m": 0.15}, position_m=[-0.1, 0.0, 0.0]),
            ],
        },
        {
            "name": "block", "position_m": [-1.2, 0.3, 0.05],
            "orientation_xyzw": [0.0, 0.0, 1.0, -1e-17],
            "shapes": [shape("block", {"kind": "box", "size_m": [0.1, 0.1, 0.1]})],
        },
        {
            "name": "ball", "position_m": [-1.0, -0.5, 0.06], "mass_kg": 0.25,
            "orientation_xyzw": [0.6, 0.0, 0.0, -0.8],
            "shapes": [shape("ball", {"kind": "sphere", "radius_m": 0.06}, material="tiles")],
        },
        {
            "name": "kegs", "position_m": [0.9, -0.6, 0.1], "mass_kg": 1.5,
            "shapes": [
                shape("pyramid", {"kind": "mesh", "file": "two.glb", "submesh": "pyramid",
                                  "scale": [0.1, 0.1, 0.2]}),
                shape("all", {"kind": "mesh", "file": "two.glb", "scale": [0.1, -0.1, 0.1]},
                      material="two.glb"),
            ],
        },
    ]  # fmt: skip
    return made


def make(where: Path, made: dict[str, Any] | None = None) -> Path:
    """Write the recipe and what it needs: its file."""
    made = made or recipe()
    (where / "textures").mkdir(parents=True, exist_ok=True)
    (where / "textures/brick.png").write_bytes(folder.png())
    (where / "textures/other.png").write_bytes(folder.png(32, 32))
    (where / "meshes").mkdir(exist_ok=True)
    (where / "meshes/two.glb").write_bytes(two_parts())
    folder.write(where, made["name"], recipe_yaml(made))
    return where / f"{made['name']}.yaml"


def two_parts() -> bytes:
    """A box and a pyramid of two colours."""
    scene: Any = trimesh.Scene()
    visual: Any = trimesh.visual
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    pyramid = trimesh.Trimesh(
        [[0, 0, 1], [1, 0, 0], [0, 1, 0], [0, 0, 0]], [[0, 1, 2], [0, 2, 3], [0, 3, 1], [3, 2, 1]]
    )
    for name, mesh, colour in (
        ("box", box, (200, 30, 40, 255)),
        ("pyramid", pyramid, (20, 130, 40, 255)),
    ):
        material = visual.material.PBRMaterial(name=name, baseColorFactor=colour)
        mesh.visual = visual.TextureVisuals(material=material)
        scene.add_geometry(mesh, node_name=name, geom_name=name)
    data = scene.export(file_type="glb")
    assert isinstance(data, bytes)
    return data


def root_of(loaded: LoadedWorld) -> etree._Element:
    """Of the SDF file that a world becomes."""
    return etree.fromstring(export_files(loaded)[f"{loaded.world.name}.sdf"])


def imported(file: Path) -> ImportedWorld:
    return to_recipe(read_sdf(file, (file.parent,)), file.stem)


def reloaded(world: ImportedWorld, where: Path) -> LoadedWorld:
    file = where / f"{world.recipe['name']}.yaml"
    write_recipe(world, file)
    return load_file(file)


def there_and_back(loaded: LoadedWorld, where: Path) -> LoadedWorld:
    """The world after an export and an import."""
    world = imported(export_world(loaded, where / "sdf"))
    assert world.report.errors == ()
    return reloaded(world, where / "back")


def differences(one: World, other: World) -> list[str]:
    """Fields that are not the same, numbers to 1e-9."""

    def compare(at: str, a: Any, b: Any) -> list[str]:
        if isinstance(a, dict) and isinstance(b, dict) and a.keys() == b.keys():
            return [line for key in a for line in compare(f"{at}.{key}", a[key], b[key])]
        if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
            pairs = enumerate(zip(a, b, strict=True))
            return [line for index, pair in pairs for line in compare(f"{at}[{index}]", *pair)]
        if isinstance(a, float) and isinstance(b, float) and abs(a - b) <= 1e-9:
            return []
        return [] if a == b else [f"{at}: {a!r:.60} != {b!r:.60}"]

    exclude = {"hash"}
    return compare(
        "", one.model_dump(mode="json", exclude=exclude),
        other.model_dump(mode="json", exclude=exclude),
    )  # fmt: skip
