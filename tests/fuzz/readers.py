"""What reads a file that a person may give, with the one error that may come of it.

Each lets through what a command prints in one line (ConfigError), and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, is_dataclass
from pathlib import Path

import numpy as np
from pydantic import BaseModel

from mazebot.cli.drive.waypoints_file import read_mission
from mazebot.cli.logs.log import ScanForm
from mazebot.cli.logs.read import read_log
from mazebot.cli.map.relations import read_relations
from mazebot.cli.map.slam_params import read_slam_params
from mazebot.cli.markers.camera_file import read_camera_file
from mazebot.cli.markers.markers_detect import read_book, read_picture
from mazebot.cli.params import in_json, models_of_all
from mazebot.cli.replay.reading.find import open_recording
from mazebot.common.config import ConfigError
from mazebot.common.files.key_file import KeyFileError, read_key
from mazebot.common.messages import wire
from mazebot.common.messages.action_documents import ReadModel
from mazebot.common.messages.topics import QUERIES, TOPICS
from mazebot.common.nav2_params.report import report
from mazebot.common.problems import words
from mazebot.common.recordings.catalog import run_at
from mazebot.common.recordings.mcap.mcap_file import repair
from mazebot.common.recordings.mcap.mcap_records import McapError
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.series import read_series
from mazebot.common.settings.load import read_nav2_params, read_settings, sections
from mazebot.common.world.map_files import read_map
from mazebot.mapping.graph.graph_file import graph_of, load_graph
from mazebot.navigation.behavior.nodes.xml_loader import read_tree_file
from mazebot.worldgen.check import findings_of
from mazebot.worldgen.models.model_reading import entity_of
from mazebot.worldgen.sdf.reading.material_script import material_in

CORPUS = Path(__file__).parent / "corpus"
"""Of each reader a folder of small files."""
LONGEST_LINE = 2000


@dataclass(frozen=True)
class Reader:
    """A kind of file, and what reads it."""

    name: str
    file: str
    """Name of the file, which may tell the kind."""
    read: Callable[[Path], object]

    def examples(self) -> Iterator[bytes]:
        """Files of the corpus."""
        for path in sorted((CORPUS / self.name).iterdir()):
            yield path.read_bytes()


def told(line: str) -> None:
    """Raises AssertionError unless it is one line for a person."""
    if not line.strip() or len(line) > LONGEST_LINE or words(line) != line:
        raise AssertionError(f"must be one printable line: {line[:300]!r}")


def all_finite(value: object, where: str = "") -> None:
    """Raises AssertionError where a number in what was read is not finite: whoever uses it would
    fail later, far from the file. Ranges may say that a beam has measured nothing.
    """
    if isinstance(value, float | np.ndarray | np.number):
        if not np.isfinite(value).all():
            raise AssertionError(f"{where} must be finite: {value!r:.80}")
    elif isinstance(value, Mapping):
        for key, one in value.items():
            all_finite(one, f"{where}[{key!r}]")
    elif isinstance(value, list | tuple):
        for one in value:
            all_finite(one, f"{where}[]")
    elif isinstance(value, BaseModel) or is_dataclass(value):
        for name, one in vars(value).items():
            if name != "ranges_m":
                all_finite(one, f"{where}.{name}")


def _world(path: Path) -> None:
    """Whatever kind of file it is; it also becomes a recipe."""
    for problem in findings_of(path).problems:
        told(str(problem))


def _model_text(path: Path) -> None:
    """What a request of ROS 2 to spawn an entity holds."""
    reply = entity_of(ReadModel(text=path.read_bytes().decode("utf-8", "replace")))
    if reply.error:
        told(words(reply.error))


def _mesh(path: Path) -> None:
    shape = f"<geometry><mesh><uri>{path.name}</uri></mesh></geometry>"
    parts = f'<collision name="c">{shape}</collision><visual name="v">{shape}</visual>'
    world = path.with_name("world.sdf")
    world.write_text(
        f'<sdf version="1.9"><world name="w"><model name="m"><static>true</static>'
        f'<link name="l">{parts}</link></model></world></sdf>'
    )
    _world(world)


def _map(path: Path) -> None:
    path.with_name("map.pgm").write_bytes(b"P5 2 2 255\n\0\xfe\xcd\0")
    _sound_map(path)


def _sound_map(path: Path) -> None:
    read = read_map(path)
    all_finite(read)
    if read.cells.min() < -1 or read.cells.max() > 100:
        raise AssertionError("cells must be -1 to 100")


def _map_image(path: Path) -> None:
    yaml = path.with_name("map.yaml")
    yaml.write_text(
        f"image: {path.name}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        "occupied_thresh: 0.65\nfree_thresh: 0.25\n"
    )
    _sound_map(yaml)


def _nav2_params(path: Path) -> None:
    in_json(report(read_nav2_params(path), _MODELS))


def _settings(path: Path) -> None:
    read_settings(path, dict.fromkeys(sections()))


def _log(path: Path) -> None:
    log = read_log(path, ScanForm())
    all_finite(log)
    times_ns = [entry.stamp_ns for entry in log.entries]
    if times_ns != sorted(times_ns):
        raise AssertionError("times must not go back")
    if not log.scans:
        raise AssertionError("a log that is read must have a scan")


def _bag(path: Path) -> None:
    recording = open_recording(path.parent, path.name)
    for _ in recording.read():
        pass


def _cut_recording(path: Path) -> None:
    before = path.read_bytes()
    try:
        repair(path, {})
    except McapError as error:
        told(str(error))
        if path.read_bytes() != before:
            raise AssertionError("a file that cannot be repaired was changed") from error
        return
    if not scan(path).is_whole:
        raise AssertionError("a repaired file is not whole")


def _run(path: Path) -> None:
    run_at(path.parent)
    read_series(path.parent)


def _key(path: Path) -> None:
    try:
        read_key(path)
    except KeyFileError as error:
        raise ConfigError(str(error)) from error


def _graph(path: Path) -> None:
    document = load_graph(path)
    graph_of(document, path.name)
    all_finite(document)


def _material(path: Path) -> None:
    material_in(path.read_bytes().decode("utf-8", "replace"), "m")


def _topic_message(path: Path) -> None:
    """The first byte is the topic."""
    data = path.read_bytes()
    if data:
        topic = TOPICS[data[0] % len(TOPICS)]
        try:
            wire.validate(topic, wire.decode(topic, data[1:]))
        except wire.WireError as error:
            told(str(error))


def _document(path: Path) -> None:
    """The first byte is the query."""
    data = path.read_bytes()
    if data:
        query = QUERIES[data[0] % len(QUERIES)]
        try:
            wire.decode_json(query.request, data[1:])
        except wire.WireError as error:
            told(str(error))


_MODELS = models_of_all()
READERS = (
    Reader("recipe", "world.yaml", _world),
    Reader("sdf", "world.sdf", _world),
    Reader("urdf", "robot.urdf", _world),
    Reader("xacro", "world.sdf.xacro", _world),
    Reader("model_text", "model.sdf", _model_text),
    Reader("obj", "m.obj", _mesh),
    Reader("stl", "m.stl", _mesh),
    Reader("dae", "m.dae", _mesh),
    Reader("glb", "m.glb", _mesh),
    Reader("material", "m.material", _material),
    Reader("map", "map.yaml", _map),
    Reader("pgm", "map.pgm", _map_image),
    Reader("tree", "tree.xml", read_tree_file),
    Reader("nav2_params", "nav2.yaml", _nav2_params),
    Reader("settings", "config.yaml", _settings),
    Reader("carmen", "a.log", _log),
    Reader("csv", "a.csv", _log),
    Reader("mcap", "a.mcap", _log),
    Reader("db3", "a.db3", _log),
    Reader("bag", "b.mcap", _bag),
    Reader("ros1", "a.bag", _log),
    Reader("ros1_bag", "b.bag", _bag),
    Reader("cut_recording", "run.mcap", _cut_recording),
    Reader("relations", "a.relations", lambda path: all_finite(read_relations(path))),
    Reader("slam_params", "slam.yaml", read_slam_params),
    Reader("graph", "map.posegraph", _graph),
    Reader("waypoints", "w.yaml", lambda path: all_finite(read_mission([f"{path}"]))),
    Reader("camera", "camera.yaml", lambda path: all_finite(read_camera_file(path))),
    Reader("dictionary", "codes.yml", lambda path: read_book(str(path))),
    Reader("picture", "picture.png", read_picture),
    Reader("summary", "summary.json", _run),
    Reader("series", "series.json", _run),
    Reader("key", "anna.key", _key),
    Reader("topic_message", "message.bin", _topic_message),
    Reader("document", "document.bin", _document),
)
