"""`mazebot markers make` and `mazebot markers detect`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from mazebot.cli.parsing.command import App
from mazebot.cli.parsing.options import Json
from mazebot.common.config import ConfigError
from mazebot.common.messages.documents import DICTIONARY_FILES

KINDS = ("panel", "cube")

app = App(help="Make models of ArUco markers, and detect markers in images.")


@app.command()
def make(
    marker_id: Annotated[int, typer.Argument(metavar="ID", min=0, help="id of the marker")],
    dictionary: Annotated[
        str, typer.Option(help="OpenCV's dictionary name, or a file as OpenCV writes it")
    ] = "DICT_4X4_100",
    size_m: Annotated[float, typer.Option("--size", help="side of the black square, metres")] = 0.3,
    kind: Annotated[str, typer.Option(help="panel or cube")] = "panel",
    quiet_zone: Annotated[
        int, typer.Option(min=1, max=16, help="white modules around the black square")
    ] = 1,
    out: Annotated[Path, typer.Option(help="folder of models")] = Path("models"),
) -> None:
    """Write models/aruco_id_ID: model.config, model.sdf, meshes and textures, for Gazebo."""
    from mazebot.worldgen.sdf.marker_model import write_marker_model  # noqa: PLC0415

    if kind not in KINDS:
        raise ConfigError(f"--kind: {kind!r}: must be one of {', '.join(KINDS)}")
    file = Path(dictionary) if dictionary.endswith(DICTIONARY_FILES) else None
    folder = write_marker_model(
        out,
        marker_id,
        file.stem if file else dictionary,
        size_m,
        "cube" if kind == "cube" else "panel",
        quiet_zone,
        dictionary_file=file,
    )
    sys.stdout.write(f"{folder}\n")


@app.command()
def detect(
    images: Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="pictures")],
    dictionary: Annotated[
        str, typer.Option(help="OpenCV's dictionary name, or a file as OpenCV writes it")
    ] = "DICT_4X4_100",
    camera: Annotated[
        Path | None,
        typer.Option(help="calibration for poses: ROS' camera_info or OpenCV's YAML"),
    ] = None,
    size_m: Annotated[
        float | None, typer.Option("--size", help="side of the black square, metres")
    ] = None,
    corner_sigma_px: Annotated[
        float,
        typer.Option(
            "--corner-sigma", help="least standard deviation of a corner, pixels, for covariances"
        ),
    ] = 0.3,
    draw: Annotated[
        Path | None,
        typer.Option(help="draw outlines, ids and axes in this image; a folder for several images"),
    ] = None,
    as_json: Json = False,
) -> None:
    """Detect the markers in images: ids, corners and, with a camera, poses in its optical frame."""
    from mazebot.cli.markers.markers_detect import detect_markers  # noqa: PLC0415 - loads OpenCV

    detect_markers(images, dictionary, camera, size_m, corner_sigma_px, as_json, draw)
