"""`mazebot world list|show|check|build|import|export|preview`."""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.progress import track
from rich.table import Table

from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.completion import world_names
from mazebot.cli.parsing.options import Json, model_folders, print_json, xacro_arguments
from mazebot.cli.parsing.outputs import refuse_inputs
from mazebot.common.config import ConfigError
from mazebot.common.settings.load import load
from mazebot.worldgen.config import WorldgenConfig

if TYPE_CHECKING:
    from mazebot.common.maths.frames import Array
    from mazebot.worldgen.recipe.loaded_world import LoadedWorld
    from mazebot.worldgen.sdf.model import ImportReport, SdfWorld

app = App(help="Make worlds: recipes, mazes, SDF in and out, maps, previews.")

FOUND_SOMETHING = 1
"""Exit code if a world was read and contains problems."""

World = Annotated[
    str, typer.Argument(help="a world's name, or a recipe's file", autocompletion=world_names)
]
Anything = Annotated[
    str,
    typer.Argument(
        help="a world's name, or a file: recipe, SDF, URDF or xacro", autocompletion=world_names
    ),
]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", help="field=value, overrides the recipe's, e.g. wall_height_m=2.5"),
]
Arguments = Annotated[
    list[str] | None, typer.Option("--arg", help="name:=value, an argument of a xacro file")
]
Roots = Annotated[
    list[Path] | None,
    typer.Option("--path", help="folder of models, searched before GZ_SIM_RESOURCE_PATH"),
]

WorldsDir = Annotated[
    Path | None, typer.Option("--worlds-dir", help="folder of recipes [default: worlds]")
]


@app.command("list")
def list_worlds(worlds_dir: WorldsDir = None, as_json: Json = False) -> None:
    """List the available worlds."""
    from mazebot.worldgen.recipe.loader import load_world  # noqa: PLC0415
    from mazebot.worldgen.recipe.sources import SHORT_NAMES, known_worlds  # noqa: PLC0415

    folder = _worlds_dir(worlds_dir)
    short_of = {name: short for short, name in SHORT_NAMES.items()}
    rows, wrong = [], []
    known = known_worlds(folder)
    if not known:
        raise ConfigError(f"--worlds-dir: {folder}: contains no *.yaml")
    for name in known:
        try:
            world = load_world(name, worlds_dir=folder).world
        except ConfigError as error:
            wrong.append(str(error))
            continue
        rows.append(
            {
                "name": name,
                "short": short_of.get(name, ""),
                "walls": len(world.walls),
                "bodies": len(world.bodies),
                "markers": len(world.markers),
                "rooms": len(world.rooms),
                "locations": len(world.locations),
                "hash": world.hash,
            }
        )
    if as_json:
        print_json(rows)
    else:
        _print_table(rows)
    for line in wrong:
        sys.stderr.write(f"error: {line}\n")
    if wrong:
        raise typer.Exit(FOUND_SOMETHING)


@app.command()
def show(
    world: Anything,
    frames: Annotated[
        bool, typer.Option("--frames", help="poses of all models, links, joints and frames (SDF)")
    ] = False,
    overrides: Set = None,
    arguments: Arguments = None,
    path: Roots = None,
    worlds_dir: WorldsDir = None,
    as_json: Json = False,
) -> None:
    """Print the contents of a world."""
    if frames:
        if not _is_sdf(world):
            raise ConfigError(f"--frames: {world!r}: must be an SDF, URDF or xacro file")
        sdf = _read_sdf(Path(world), arguments, path)
        if as_json:
            print_json({"world": sdf.name, "frames": [_frame(frame) for frame in sdf.frames]})
        else:
            rows = [_frame(frame) for frame in sdf.frames]
            _print_table([{**row, **{k: _short(v) for k, v in row.items()}} for row in rows])
        _print_errors(sdf.report)
        return
    loaded = _loaded(world, overrides, arguments, path, worlds_dir)
    if as_json:
        print_json(loaded.world.model_dump(mode="json"))
        return
    _print_table([{"": key, "value": value} for key, value in _summary(loaded).items()])


@app.command()
def check(
    worlds: Annotated[
        list[str],
        typer.Argument(help="names of worlds, or files", autocompletion=world_names),
    ],
    overrides: Set = None,
    arguments: Arguments = None,
    path: Roots = None,
    worlds_dir: WorldsDir = None,
    as_json: Json = False,
) -> None:
    """List all problems of worlds, each with file, line and field, and print how much of the floor
    is reachable; exit code 1 if there is a problem.
    """
    from mazebot.worldgen.check import findings_of  # noqa: PLC0415
    from mazebot.worldgen.files import is_file  # noqa: PLC0415

    found: dict[str, list[dict[str, Any]]] = {}
    for world in worlds:
        problems, reach = findings_of(
            Path(world) if is_file(world) or _is_sdf(world) else world,
            worlds_dir=_worlds_dir(worlds_dir),
            overrides=tuple(overrides or ()),
            arguments=xacro_arguments(arguments),
            roots=model_folders("--path", path),
        )
        found[world] = [problem.model_dump(mode="json") for problem in problems]
        if not as_json:
            for problem in problems:
                sys.stderr.write(f"{problem}\n")
            count = f"{len(problems)} problem{'s' if len(problems) > 1 else ''}"
            floor = f"; {reach}" if reach else ""
            sys.stdout.write(f"{world}: {count if problems else 'no problems'}{floor}\n")
    if as_json:
        print_json(found)
    if any(found.values()):
        raise typer.Exit(FOUND_SOMETHING)


@app.command()
def build(
    world: World,
    out: Annotated[Path, typer.Option(help="new folder for all output files")],
    overrides: Set = None,
    count: Annotated[
        int, typer.Option(min=1, max=100_000, help="number of mazes, with increasing maze.seed")
    ] = 1,
    worlds_dir: WorldsDir = None,
) -> None:
    """Write all files of a world: description, map, plan, GLB, SDF and figures."""
    from mazebot.worldgen.build import build_world  # noqa: PLC0415

    variants = [tuple(overrides or ())]
    if count > 1:
        loaded = _loaded(world, overrides, None, None, worlds_dir)
        if loaded.recipe is None or loaded.recipe.maze is None:
            raise ConfigError(f"--count: {count}: {world} has no maze, so no seed to count")
        first = loaded.recipe.maze.seed
        variants = [(*variants[0], f"maze.seed={seed}") for seed in range(first, first + count)]
    console = Console(stderr=True)
    with _new_folder(out) as folder:
        for variant in track(
            variants, "building", console=console, transient=True, disable=not console.is_terminal
        ):
            loaded = _loaded(world, variant, None, None, worlds_dir)
            inside = folder
            if count > 1:
                inside = folder / f"{loaded.world.name}_{variant[-1].partition('=')[2]}"
                inside.mkdir()
            build_world(loaded, inside)
    sys.stdout.write(f"{out}: {count} world{'s' if count > 1 else ''}\n")


@app.command("import")
def import_world(
    file: Annotated[Path, typer.Argument(help="an SDF, URDF or xacro file, or a model's folder")],
    arguments: Arguments = None,
    path: Roots = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="recipe to write, e.g. worlds/house.yaml; textures and meshes next to it"
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Read a Gazebo world and report its contents; with --out, convert it to a recipe.

    Exit code 0 only without errors.
    """
    from mazebot.worldgen.files import rough_bodies, world_name  # noqa: PLC0415
    from mazebot.worldgen.sdf.convert import to_recipe  # noqa: PLC0415
    from mazebot.worldgen.sdf.recipe_file import write_recipe  # noqa: PLC0415

    if out is not None:
        _refuse_no_recipe(out)
    sdf = _read_sdf(file, arguments, path)
    report = sdf.report
    imported = None
    if not report.errors:
        imported = to_recipe(sdf, out.stem if out else world_name(file))
        report = imported.report
    if as_json:
        print_json(report.model_dump(mode="json"))
    elif report.models or report.includes or not report.errors:
        # Else the file could not be read, and there is nothing to report.
        _print_report(report)
    _print_errors(report)
    rough = rough_bodies(imported) if imported is not None else ""
    if rough:
        sys.stderr.write(f"warning: {rough}\n")
    if out is not None and imported is not None:
        write_recipe(imported, out)
        # With --json, standard output is JSON only.
        stream = sys.stderr if as_json else sys.stdout
        stream.write(f"{out}: converted from {file}\n")


@app.command("export")
def export(
    world: World,
    out: Annotated[Path, typer.Option(help="folder for the SDF file, textures and models")],
    overrides: Set = None,
    worlds_dir: WorldsDir = None,
) -> None:
    """Write a world as SDF for Gazebo."""
    from mazebot.worldgen.sdf.export import export_world  # noqa: PLC0415

    loaded = _loaded(world, overrides, None, None, worlds_dir)
    refuse_inputs("--out", out.glob("*"))
    file = export_world(loaded, out)
    sys.stdout.write(f"{file}: GZ_SIM_RESOURCE_PATH={out} gz sim {file.name}\n")


@app.command()
def preview(
    world: Anything,
    out: Annotated[Path | None, typer.Option(help="plan [default: <name>.png]")] = None,
    glb: Annotated[Path | None, typer.Option(help="3D model [default: <name>.glb]")] = None,
    overrides: Set = None,
    arguments: Arguments = None,
    path: Roots = None,
    worlds_dir: WorldsDir = None,
) -> None:
    """Write a plan of a world (PNG), and its 3D model (GLB)."""
    from mazebot.worldgen.preview import plan_png  # noqa: PLC0415
    from mazebot.worldgen.world_model import world_glb  # noqa: PLC0415

    loaded = _loaded(world, overrides, arguments, path, worlds_dir)
    out = out or Path(f"{loaded.world.name}.png")
    plan = _writable("--out", out, suffix=".png")
    # `with_suffix` fails on an empty name, which is refused above.
    glb = glb or out.with_suffix(".glb")
    model = _writable("--glb", glb, suffix=".glb")
    if plan == model:
        raise ConfigError(f"--glb: {glb}: must be another file than the plan")
    refuse_inputs("--out", (out,))
    refuse_inputs("--glb", (glb,))
    _write({plan: plan_png(loaded), model: world_glb(loaded)})
    sys.stdout.write(f"{out}\n{glb}\n")


def _loaded(
    world: str,
    overrides: Iterable[str] | None,
    arguments: list[str] | None,
    path: list[Path] | None,
    worlds_dir: Path | None,
) -> LoadedWorld:
    """A world by name, or from a recipe or an SDF file.

    All errors of a file are printed, one a line, before the command exits.
    """
    from mazebot.common.problems import WorldError  # noqa: PLC0415
    from mazebot.worldgen.files import load_any  # noqa: PLC0415

    refuse_unused(world, arguments, path)
    try:
        return load_any(
            world,
            worlds_dir=_worlds_dir(worlds_dir),
            overrides=tuple(overrides or ()),
            arguments=xacro_arguments(arguments),
            roots=model_folders("--path", path),
        )
    except WorldError as error:
        if not _is_sdf(world):
            raise
        for problem in error.problems:
            sys.stderr.write(f"error: {problem}\n")
        raise typer.Exit(FOUND_SOMETHING) from error


def refuse_unused(world: str, arguments: list[str] | None, path: list[Path] | None) -> None:
    """Raises ConfigError for options that do not apply to a recipe."""
    for option, given in (("--arg", arguments), ("--path", path)):
        if given and not _is_sdf(world):
            raise ConfigError(f"{option}: {given[0]}: {world} is not an SDF, URDF or xacro file")


def _read_sdf(file: Path, arguments: list[str] | None, path: list[Path] | None) -> SdfWorld:
    from mazebot.worldgen.files import check_there  # noqa: PLC0415
    from mazebot.worldgen.sdf.reading.read import read_sdf  # noqa: PLC0415

    check_there(file)
    return read_sdf(file, model_folders("--path", path), xacro_arguments(arguments))


def _worlds_dir(worlds_dir: Path | None) -> Path:
    return worlds_dir or load(WorldgenConfig, "worldgen", []).worlds_dir


def _is_sdf(world: str) -> bool:
    from mazebot.worldgen.files import is_sdf  # noqa: PLC0415

    return is_sdf(Path(world))


def _refuse_no_recipe(file: Path) -> None:
    """Raises ConfigError where a recipe written to this file could not be loaded by name."""
    from pydantic import TypeAdapter, ValidationError  # noqa: PLC0415

    from mazebot.worldgen.recipe_model import Name  # noqa: PLC0415

    try:
        TypeAdapter(Name).validate_python(file.stem)
        named = file.suffix == ".yaml"
    except ValidationError:
        named = False
    if not named:
        must = "must be called NAME.yaml, NAME of letters, digits, _, - and dots"
        raise ConfigError(f"--out: {file}: {must}")
    _writable("--out", file, new_folder=True)


def _print_errors(report: ImportReport) -> None:
    """Print the errors of an import, one a line, and exit if there are any."""
    for error in report.errors:
        text = f"{error.where}: {error.kind}: {error.message}"
        sys.stderr.write(f"error: {' '.join(text.split())}\n")
    if report.errors:
        raise typer.Exit(FOUND_SOMETHING)


def _print_report(report: ImportReport) -> None:
    def by_type(counts: dict[str, int]) -> str:
        return ", ".join(f"{count} {kind}" for kind, count in sorted(counts.items())) or "none"

    lines = [
        f"world {report.world}: {report.models} models, {report.links} links",
        f"collisions: {by_type(report.collisions)}",
        f"visuals:    {by_type(report.visuals)}",
        f"materials:  {', '.join(report.materials) or 'none'}",
        f"includes:   {', '.join(include.uri for include in report.includes) or 'none'}",
        *([f"floor:      {report.floor}"] if report.floor else []),
        *(
            f"renamed:    {one.kind} {one.name} to {one.new_name} ({one.where})"
            for one in report.renamed
        ),
        *(f"ignored:    {ignored.what} ({ignored.where})" for ignored in report.ignored),
        *(f"missing:    {one.message} ({one.where})" for one in report.missing),
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    for warning in report.warnings():
        sys.stderr.write(f"warning: {warning}\n")


def _frame(frame: Any) -> dict[str, Any]:
    return {
        "kind": frame.kind,
        "name": frame.name,
        "pose_in_model": _pose(frame.model_from_frame),
        "pose_in_world": _pose(frame.world_from_frame),
    }


def _pose(matrix: Array) -> dict[str, list[float]]:
    """Position and orientation, the latter also as SDF writes it."""
    from mazebot.common.maths.frames import quaternion_from_rotation  # noqa: PLC0415

    r = matrix[:3, :3]
    pitch = math.atan2(0.0 - r[2, 0], math.hypot(r[0, 0], r[1, 0]))
    if abs(math.cos(pitch)) > 1e-9:
        roll, yaw = math.atan2(r[2, 1], r[2, 2]), math.atan2(r[1, 0], r[0, 0])
    else:
        # At a pitch of 90 degrees only the sum or difference of roll and yaw is defined.
        roll, yaw = 0.0, math.atan2(-r[0, 1], r[1, 1])
    return {
        "position_m": [float(value) for value in matrix[:3, 3]],
        "rpy_rad": [roll, pitch, yaw],
        "orientation_xyzw": list(quaternion_from_rotation(r)),
    }


def _short(value: Any) -> str:
    if isinstance(value, dict):
        numbers = (*value["position_m"], *value["rpy_rad"])
        return " ".join(f"{number:.4g}" for number in numbers)
    return str(value)


def _summary(loaded: LoadedWorld) -> dict[str, object]:
    from mazebot.worldgen.build import figures  # noqa: PLC0415

    world = loaded.world
    rows, columns = loaded.map_cells.shape
    return {
        "name": world.name,
        "hash": world.hash,
        "walls": len(world.walls),
        "bodies": len(world.bodies),
        "materials": ", ".join(material.name for material in world.materials),
        "rooms": ", ".join(room.name for room in world.rooms) or "none",
        "markers": ", ".join(f"{m.id} on {m.wall}" for m in world.markers) or "none",
        "locations": ", ".join(
            f"{at.name} ({at.x_m:g}, {at.y_m:g}, {at.yaw_rad:g})" for at in world.locations
        )
        or "none",
        "start": f"({world.start.x_m:g}, {world.start.y_m:g}, {world.start.yaw_rad:g})",
        "map": f"{columns} x {rows} cells of {world.map_resolution_m:g} m",
        **{
            name: f"{value:g}" if isinstance(value, float) else str(value)
            for name, value in figures(loaded).items()
        },
    }


def _print_table(rows: list[dict[str, Any]]) -> None:
    table = Table(box=box.SIMPLE_HEAD)
    for heading in rows[0] if rows else ():
        table.add_column(heading, overflow="fold")
    for row in rows:
        table.add_row(*(str(value) for value in row.values()))
    console = Console()
    if not console.is_terminal:
        console.width = 200
    console.print(table)


@contextmanager
def _new_folder(folder: Path) -> Iterator[Path]:
    """A folder that appears only when it is complete.

    Raises ConfigError where it is not empty, or cannot be made.
    """
    try:
        if folder.is_symlink() or (
            folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
        ):
            raise ConfigError(f"--out: {folder}: must be a new or an empty folder")
        folder.parent.mkdir(parents=True, exist_ok=True)
        making = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ConfigError(f"--out: {folder}: cannot be created: {error.strerror}") from error
    try:
        yield making
        making.chmod(0o755)
        making.replace(folder)
    except OSError as error:
        raise ConfigError(f"--out: {folder}: cannot be created: {error.strerror}") from error
    finally:
        shutil.rmtree(making, ignore_errors=True)


def _writable(option: str, file: Path, new_folder: bool = False, suffix: str = "") -> Path:
    """The path to which a file will be written: a link's target, so that the link stays.

    Its folder must exist, unless a new one is made, and its name must end with the suffix.

    Raises ConfigError where the path is not a file, or there is no folder to write into.
    """
    try:
        target = file.resolve()
        if not target.name or (target.exists() and not target.is_file()):
            raise ConfigError(f"{option}: {file}: must be a file, or a path that does not exist")
        if suffix and file.suffix.lower() != suffix:
            kind = suffix[1:].upper()
            raise ConfigError(f"{option}: {file}: is written as {kind}, must end with {suffix}")
        if not (new_folder or target.parent.is_dir()):
            raise ConfigError(f"{option}: {file}: no such folder: {file.parent}")
    # Circular links.
    except (OSError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or "too many symbolic links"
        raise ConfigError(f"{option}: {file}: cannot be written: {reason}") from error
    return target


def _write(files: Mapping[Path, bytes]) -> None:
    """Write files, all of them or none. Raises ConfigError where one cannot be written."""
    making: dict[Path, Path] = {}
    file = None
    try:
        for file, data in files.items():
            descriptor, name = tempfile.mkstemp(prefix=".mazebot-", dir=file.parent)
            making[file] = Path(name)
            with os.fdopen(descriptor, "wb") as opened:
                opened.write(data)
            # Only the owner can read a temporary file.
            making[file].chmod(0o644)
        for file, made in making.items():
            made.replace(file)
    except OSError as error:
        raise ConfigError(f"{file}: cannot be written: {error.strerror}") from error
    finally:
        for made in making.values():
            made.unlink(missing_ok=True)
