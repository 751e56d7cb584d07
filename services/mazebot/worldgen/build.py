"""Builds all files of a world: description, map, plan, model, SDF and figures."""

from __future__ import annotations

import json
from pathlib import Path

from mazebot.common.world.map_files import write_map
from mazebot.common.world.marker_entities import marker_entities
from mazebot.worldgen.difficulty import difficulty
from mazebot.worldgen.map.clearance import reach
from mazebot.worldgen.preview import plan_png
from mazebot.worldgen.recipe.loaded_world import LoadedWorld
from mazebot.worldgen.sdf.export import export_world
from mazebot.worldgen.world_model import world_glb


def build_world(loaded: LoadedWorld, folder: Path) -> None:
    """Fill an empty folder: world.json, map.yaml and .pgm, plan.png, world.glb, sdf/, figures.json.

    Raises ConfigError if a file cannot be written.
    """
    world = loaded.world
    (folder / "world.json").write_text(world.model_dump_json(indent=2) + "\n", encoding="utf-8")
    write_map(folder, "map", loaded.map_cells, world.map_resolution_m, loaded.map_origin)
    (folder / "plan.png").write_bytes(plan_png(loaded))
    (folder / "world.glb").write_bytes(world_glb(loaded))
    export_world(loaded, folder / "sdf")
    figures_json = json.dumps(figures(loaded), indent=2) + "\n"
    (folder / "figures.json").write_text(figures_json, encoding="utf-8")


def figures(loaded: LoadedWorld) -> dict[str, object]:
    """Difficulty of a world, its reachable floor, and its markers."""
    entities, _ = marker_entities(loaded.world, meshes=loaded.meshes)
    floor = reach(loaded.world, loaded.meshes)
    return {
        **difficulty(loaded).model_dump(),
        "reachable_m2": round(floor.reachable_m2, 4),
        "reachable_share": round(floor.share, 4),
        "markers_hanging": len(entities.entities),
        "markers_refused": len(entities.refused),
    }
