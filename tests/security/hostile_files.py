"""A table of hostile files: each is written small, or sparse, and given to the command that reads
its kind.
"""

from __future__ import annotations

import bz2
import gzip
import io
import json
import os
import socket
import sqlite3
import struct
import zlib
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mazebot.common.recordings.mcap import mcap_records as mcap

Write = Callable[[Path], None]
GIB = 1 << 30


@dataclass(frozen=True)
class Hostile:
    """A hostile input: what writes it into an empty folder, and the command that reads it there."""

    name: str
    command: tuple[str, ...]
    write: Write
    words: tuple[str, ...]
    """Parts of what is printed, with `|` between alternatives."""
    exit_codes: tuple[int, ...] = (1, 2)
    """With 0 where it may be read, within the limits."""


def text(file: str, content: str | bytes) -> Write:
    """Writes one file."""
    data = content.encode("utf-8", "surrogateescape") if isinstance(content, str) else content

    def write(folder: Path) -> None:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).write_bytes(data)

    return write


def all_of(*parts: Write) -> Write:
    """Writes several files."""

    def write(folder: Path) -> None:
        for part in parts:
            part(folder)

    return write


def sparse(file: str, begin: bytes = b"", size: int = 3 * GIB) -> Write:
    """A file of some size without content after its beginning."""

    def write(folder: Path) -> None:
        with (folder / file).open("wb") as opened:
            opened.write(begin)
            opened.truncate(size)

    return write


def link(file: str, target: str) -> Write:
    """A symbolic link."""

    def write(folder: Path) -> None:
        (folder / file).parent.mkdir(parents=True, exist_ok=True)
        (folder / file).symlink_to(target)

    return write


def pipe(file: str) -> Write:
    """A named pipe that nobody writes to."""
    return lambda folder: os.mkfifo(folder / file)


def unix_socket(file: str) -> Write:
    """A socket in the file system."""

    def write(folder: Path) -> None:
        with closing(socket.socket(socket.AF_UNIX)) as opened:
            here = Path.cwd()
            os.chdir(folder)
            try:
                opened.bind(file)
            finally:
                os.chdir(here)

    return write


def subfolder(file: str) -> Write:
    """A folder in place of a file."""
    return lambda folder: (folder / file).mkdir(parents=True)


def png(width: int, height: int, rows: int, end: bool = True) -> bytes:
    """A grey PNG that declares a size, with some rows in it."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    packer = zlib.compressobj(9)
    row = bytes(width + 1)
    packed = b"".join(packer.compress(row) for _ in range(rows)) + packer.flush()
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", packed)
    return data + (chunk(b"IEND", b"") if end else b"")


BOMB_ENTITIES = "".join(
    f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "lol" * 10}">' for i in range(10)
)
ALIASES = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 10)
)
MERGES = "a0: &a0 {k: 1}\n" + "".join(
    f"a{i}: &a{i} {{<<: [{', '.join([f'*a{i - 1}'] * 9)}]}}\n" for i in range(1, 10)
)
DEEP_YAML = "a: " + "[" * 100_000
DEEP_JSON = '{"a":' + "[" * 100_000 + "]" * 100_000 + "}"
ESCAPES = "\x1b]0;owned\x07\x1b[2J"


def sdf(model: str, extra: str = "") -> str:
    """An SDF world with a model's content."""
    return (
        f'<?xml version="1.0"?>{extra}<sdf version="1.9"><world name="w"><model name="m">'
        f'<static>true</static><link name="l">{model}</link></model></world></sdf>'
    )


def meshed(uri: str) -> Write:
    """world.sdf with one mesh."""
    shape = f"<geometry><mesh><uri>{uri}</uri></mesh></geometry>"
    both = f'<collision name="c">{shape}</collision><visual name="v">{shape}</visual>'
    return text("world.sdf", sdf(both))


def mesh(file: str, data: str | bytes) -> Write:
    """world.sdf and its mesh."""
    return all_of(meshed(file), text(file, data))


def textured(write: Write) -> Write:
    """world.sdf with a box whose texture is texture.png."""
    box = (
        '<visual name="v"><geometry><box><size>1 1 1</size></box></geometry><material><pbr><metal>'
        "<albedo_map>texture.png</albedo_map></metal></pbr></material></visual>"
    )
    return all_of(text("world.sdf", sdf(box)), write)


def xacro(body: str) -> Write:
    """world.sdf.xacro."""
    return text(
        "world.sdf.xacro",
        f'<sdf version="1.9" xmlns:xacro="http://www.ros.org/wiki/xacro">{body}</sdf>',
    )


def evaluated(expression: str) -> Write:
    """world.sdf.xacro with one expression."""
    return xacro(f'<xacro:property name="p" value="${{{expression}}}"/><world name="${{p}}"/>')


def map_of(image: str, *writes: Write, more: str = "") -> Write:
    """map.yaml that names an image."""
    fields = (
        f"image: {image}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\n"
        f"occupied_thresh: 0.65\nfree_thresh: 0.25\n{more}"
    )
    return all_of(text("map.yaml", fields), *writes)


def collada(body: str, head: str = "") -> str:
    """A COLLADA file."""
    return (
        f'<?xml version="1.0"?>{head}<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" '
        f'version="1.4.1"><asset><up_axis>Z_UP</up_axis></asset>{body}</COLLADA>'
    )


def mcap_file(*records: bytes) -> bytes:
    """An MCAP file of records, with its end."""
    end = mcap.record(mcap.DATA_END, b"\0" * 4) + mcap.record(mcap.FOOTER, b"\0" * 20)
    return mcap.MAGIC + mcap.header("ros2", "x") + b"".join(records) + end + mcap.MAGIC


_ZEROS = mcap.record(0x80, bytes(1 << 20))


def zstd_bomb(megabytes: int, declared: int) -> bytes:
    """A chunk of megabytes of zeros that declares a size, in zstd."""
    packer = zstandard.ZstdCompressor(level=3).compressobj()
    packed = b"".join(packer.compress(_ZEROS) for _ in range(megabytes)) + packer.flush()
    return mcap.chunk_record(mcap.Chunk(1, 2, declared, 0, "zstd", packed))


def lz4_bomb(megabytes: int, declared: int) -> bytes:
    """A chunk of megabytes of zeros that declares a size, in lz4."""
    packed = io.BytesIO()
    with lz4.frame.open(packed, "wb") as opened:
        for _ in range(megabytes):
            opened.write(_ZEROS)
    return mcap.chunk_record(mcap.Chunk(1, 2, declared, 0, "lz4", packed.getvalue()))


def ros1_bomb(megabytes: int) -> bytes:
    """A bag of ROS 1 with two chunks of megabytes of zeros each, which they do say."""
    packer = bz2.BZ2Compressor(1)
    packed = b"".join(packer.compress(bytes(1 << 20)) for _ in range(megabytes)) + packer.flush()
    fields = (b"op=\5", b"compression=bz2", b"size=" + struct.pack("<I", megabytes << 20))
    head = b"".join(struct.pack("<I", len(field)) + field for field in fields)
    chunk = struct.pack("<I", len(head)) + head + struct.pack("<I", len(packed)) + packed
    return b"#ROSBAG V2.0\n" + 2 * chunk


def scan_channel() -> bytes:
    """A schema and a channel of /scan."""
    schema = mcap.schema_record(mcap.Schema(1, "sensor_msgs/msg/LaserScan", "ros2msg", b""))
    return schema + mcap.channel_record(mcap.Channel(1, 1, "/scan", "cdr", {}))


def message(data: bytes) -> bytes:
    """A message on that channel."""
    return mcap.record(mcap.MESSAGE, mcap.MESSAGE_HEAD.pack(1, 0, 1, 1), data)


def cdr_scan(count: int) -> bytes:
    """A LaserScan that declares a number of ranges, and has none."""
    head = b"\0\1\0\0" + struct.pack("<iI", 0, 0) + struct.pack("<I", 5) + b"base\0\0\0\0"
    return head + struct.pack("<7f", -1, 1, 0.1, 0, 0, 0.1, 9.0) + struct.pack("<I", count)


def database(*statements: str, file: str = "bag.db3") -> Write:
    """A file of SQLite."""

    def write(folder: Path) -> None:
        with closing(sqlite3.connect(folder / file)) as opened:
            for statement in statements:
                opened.execute(statement)
            opened.commit()

    return write


TOPICS = (
    "CREATE TABLE topics(id INTEGER, name TEXT, type TEXT, serialization_format TEXT)",
    "INSERT INTO topics VALUES(1, '/scan', 'sensor_msgs/msg/LaserScan', 'cdr')",
)
ENDLESS = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) "


def zstd_file(file: str, begin: bytes, megabytes: int) -> Write:
    """A file packed by zstd: a beginning, then zeros."""

    def write(folder: Path) -> None:
        packer = zstandard.ZstdCompressor(level=3).compressobj()
        with (folder / file).open("wb") as opened:
            opened.write(packer.compress(begin))
            for _ in range(megabytes):
                opened.write(packer.compress(bytes(1 << 20)))
            opened.write(packer.flush())

    return write


def gzip_file(file: str, begin: bytes, megabytes: int) -> Write:
    """A file packed by gzip: a beginning, then one line without end."""

    def write(folder: Path) -> None:
        with gzip.open(folder / file, "wb", compresslevel=1) as opened:
            opened.write(begin)
            for _ in range(megabytes):
                opened.write(b" " * (1 << 20))

    return write


def run(**files: str | bytes) -> Write:
    """A run's folder: summary, config, labels or series of some content."""
    endings = {"summary": "json", "config": "yaml", "labels": "json", "series": "json"}
    return all_of(
        text("runs/r/run.mcap", mcap_file()),
        *(text(f"runs/r/{name}.{endings[name]}", data) for name, data in files.items()),
    )


def glb(header: object, binary: bytes = b"") -> bytes:
    """A binary glTF file."""
    data = header if isinstance(header, bytes) else json.dumps(header).encode()
    data += b" " * (-len(data) % 4)
    body = struct.pack("<II", len(data), 0x4E4F534A) + data
    if binary:
        body += struct.pack("<II", len(binary), 0x004E4942) + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def accessor_glb(count: int) -> bytes:
    """A mesh whose accessor declares a number of vertices."""
    header = {
        "asset": {"version": "2.0"}, "scenes": [{"nodes": [0]}], "scene": 0,
        "nodes": [{"mesh": 0}], "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"componentType": 5126, "count": count, "type": "VEC3"}],
        "buffers": [{"byteLength": 12}],
    }  # fmt: skip
    return glb(header, bytes(12))


_CHECK = ("world", "check")
SDF = (*_CHECK, "world.sdf")
RECIPE = (*_CHECK, "./world.yaml")
XACRO = (*_CHECK, "world.sdf.xacro")
PLAN = ("plan", "--map", "map.yaml", "--start", "0,0", "--goal", "1,1")
PARAMS = ("params", "nav2.yaml")
CONFIG = ("demo", "--config", "config.yaml", "--no-record")
TREE = ("tree", "tree.xml")
DETECT = ("markers", "detect", "picture.png")
CAMERA = (*DETECT, "--camera", "camera.yaml", "--size", "0.1")
DICTIONARY = ("markers", "detect", "picture.png", "--dictionary", "./codes.yml")
INFO = ("recordings", "info", "r", "--dir", "runs")
COMPARE = ("recordings", "compare", "r", "r", "--dir", "runs")
DIFF = ("diff", "runs/r", "runs/r")


def log_of(file: str) -> tuple[str, ...]:
    """The command that reads a log."""
    return ("map", "build", "--log", file, "--out", "new")


def tree(body: str, head: str = "") -> Write:
    """tree.xml."""
    return text("tree.xml", f'{head}<root BTCPP_format="4">{body}</root>')


_PICTURE = text("picture.png", png(64, 64, 64))
_STL_LIE = b"\0" * 80 + struct.pack("<I", 1_000_000_000) + bytes(50)
_FLAT = '{"data":[' + "0," * 2_000_000 + "0]}"

CASES = (
    # Recipes.
    Hostile("yaml-aliases", RECIPE, text("world.yaml", ALIASES), ("world.yaml:2", "alias")),
    Hostile("yaml-merges", RECIPE, text("world.yaml", MERGES), ("world.yaml:2", "alias")),
    Hostile("yaml-deep", RECIPE, text("world.yaml", DEEP_YAML), ("world.yaml", "levels")),
    Hostile(
        "yaml-tag",
        RECIPE,
        text("world.yaml", "a: !!python/object/apply:os.system [id]\n"),
        ("world.yaml:1", "tag"),
    ),
    Hostile(
        "yaml-long",
        RECIPE,
        text("world.yaml", f"name: {'x' * 10_000_000}\n"),
        ("world.yaml", "must have at most"),
    ),
    Hostile("yaml-sparse", RECIPE, sparse("world.yaml"), ("world.yaml", "must have at most")),
    Hostile("yaml-folder", RECIPE, subfolder("world.yaml"), ("world.yaml", "must be a file")),
    Hostile("yaml-pipe", RECIPE, pipe("world.yaml"), ("world.yaml", "must be a file")),
    Hostile(
        "yaml-device", RECIPE, link("world.yaml", "/dev/zero"), ("world.yaml", "must be a file")
    ),
    Hostile(
        "yaml-utf16",
        RECIPE,
        text("world.yaml", "name: x\n".encode("utf-16")),
        ("world.yaml", "UTF-8"),
    ),
    Hostile("yaml-nul", RECIPE, text("world.yaml", b"name: a\0b\n"), ("world.yaml", "control")),
    Hostile(
        "yaml-escapes",
        RECIPE,
        text("world.yaml", 'name: "\\e[2J\\e]0;x\\a"\n'),
        ("world.yaml", "name"),
    ),
    Hostile(
        "yaml-huge-number",
        RECIPE,
        text("world.yaml", f"name: x\nwall_height_m: 1{'0' * 5000}\n"),
        ("world.yaml:2", "digits"),
    ),
    Hostile(
        "recipe-texture-device",
        RECIPE,
        text("world.yaml", "name: x\nmaterials: {a: {texture: ../../../../dev/zero}}\n"),
        ("world.yaml",),
    ),
    # SDF, URDF.
    Hostile(
        "xml-laughs",
        SDF,
        text("world.sdf", f"<!DOCTYPE a [{BOMB_ENTITIES}]><sdf>&e9;</sdf>"),
        ("world.sdf", "DOCTYPE"),
    ),
    Hostile(
        "xml-external",
        SDF,
        text("world.sdf", '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><sdf>&x;</sdf>'),
        ("world.sdf", "DOCTYPE"),
    ),
    Hostile(
        "xml-utf16",
        SDF,
        text("world.sdf", f"<!DOCTYPE a [{BOMB_ENTITIES}]><sdf>&e9;</sdf>".encode("utf-16")),
        ("world.sdf",),
    ),
    Hostile(
        "xml-utf7",
        SDF,
        text("world.sdf", '<?xml version="1.0" encoding="UTF-7"?>+ADw-+ACE-DOCTYPE a+AD4-'),
        ("world.sdf",),
    ),
    Hostile("xml-deep", SDF, text("world.sdf", "<sdf>" + "<a>" * 100_000), ("world.sdf",)),
    Hostile(
        "xml-wide",
        SDF,
        text("world.sdf", "<sdf version='1.9'>" + "<a/>" * 1_000_000 + "</sdf>"),
        ("world.sdf",),
    ),
    Hostile(
        "xml-attributes",
        SDF,
        text("world.sdf", "<sdf " + " ".join(f'a{i}="1"' for i in range(100_000)) + "/>"),
        ("world.sdf",),
    ),
    Hostile("xml-empty", SDF, text("world.sdf", ""), ("world.sdf", "empty")),
    Hostile("xml-sparse", SDF, sparse("world.sdf", b"<sdf>"), ("world.sdf", "bytes")),
    Hostile("xml-pipe", SDF, pipe("world.sdf"), ("world.sdf",)),
    Hostile("xml-socket", SDF, unix_socket("world.sdf"), ("world.sdf",)),
    Hostile("xml-device", SDF, link("world.sdf", "/dev/zero"), ("world.sdf",)),
    Hostile("xml-proc", SDF, link("world.sdf", "/proc/self/environ"), ("world.sdf",)),
    Hostile(
        "sdf-include-itself",
        SDF,
        text(
            "world.sdf",
            '<sdf version="1.9"><world name="w"><include><uri>world.sdf</uri>'
            "</include></world></sdf>",
        ),
        ("world.sdf",),
    ),
    Hostile(
        "sdf-include-passwd",
        SDF,
        text(
            "world.sdf",
            '<sdf version="1.9"><world name="w"><include><uri>file:///etc/passwd'
            "</uri></include></world></sdf>",
        ),
        ("world.sdf",),
    ),
    Hostile(
        "sdf-infinite",
        SDF,
        text(
            "world.sdf",
            sdf(
                '<collision name="c"><pose>1e400 nan inf 0 0 0</pose><geometry>'
                "<box><size>1e400 nan 1</size></box></geometry></collision>"
            ),
        ),
        ("world.sdf",),
    ),
    Hostile(
        "sdf-escapes",
        SDF,
        text("world.sdf", sdf("").replace('name="m"', f'name="{ESCAPES}"')),
        ("world.sdf",),
    ),
    Hostile(
        "sdf-escapes-c1",
        SDF,
        text("world.sdf", sdf("<frob>\x9b2J</frob>").replace('name="m"', 'name="\x9b2J\x9d0;x"')),
        (),
        (0,),
    ),
    Hostile(
        "urdf-laughs",
        (*_CHECK, "robot.urdf"),
        text("robot.urdf", f"<!DOCTYPE a [{BOMB_ENTITIES}]><robot name='r'>&e9;</robot>"),
        ("robot.urdf", "DOCTYPE"),
    ),
    Hostile(
        "config-model-laughs",
        (*_CHECK, "models"),
        all_of(
            text("models/model.config", f"<!DOCTYPE a [{BOMB_ENTITIES}]><model>&e9;</model>"),
            text("models/model.sdf", "<sdf/>"),
        ),
        ("model",),
    ),
    Hostile(
        "config-model-pipe",
        (*_CHECK, "models"),
        all_of(subfolder("models"), pipe("models/model.config")),
        ("model",),
    ),
    # Meshes.
    Hostile("stl-count", SDF, mesh("m.stl", _STL_LIE), ("m.stl",)),
    Hostile(
        "stl-nan",
        SDF,
        mesh(
            "m.stl",
            b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", *[float("nan")] * 12, 0),
        ),
        ("m.stl",),
    ),
    Hostile(
        "obj-index",
        SDF,
        mesh("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 999999999999\n"),
        ("m.obj",),
    ),
    Hostile(
        "obj-infinite", SDF, mesh("m.obj", "v 0 0 1e400\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n"), ("m.obj",)
    ),
    Hostile(
        "obj-material-passwd",
        SDF,
        mesh("m.obj", "mtllib ../../../../../etc/passwd\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
        ("m.obj",),
    ),
    Hostile(
        "obj-long-face",
        SDF,
        mesh("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf " + "1 2 3 " * 1_000_000 + "\n"),
        ("m.obj",),
    ),
    Hostile("obj-comments", SDF, mesh("m.obj", "v 0 0 0 " + " #" * 2_000_000), ("m.obj",)),
    Hostile(
        "obj-many-faces",
        SDF,
        mesh("m.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n" + "f 1 2 3\n" * 6_000_000),
        ("m.obj",),
    ),
    Hostile(
        "dae-laughs",
        SDF,
        mesh("m.dae", collada("<a>&e9;</a>", f"<!DOCTYPE a [{BOMB_ENTITIES}]>")),
        ("m.dae",),
    ),
    Hostile(
        "dae-count",
        SDF,
        mesh(
            "m.dae",
            collada(
                '<library_geometries><geometry id="g"><mesh><source id="s"><float_array id="f" '
                'count="9000000000">0 0 0</float_array><technique_common><accessor source="#f" '
                'count="3000000000" stride="3"/></technique_common></source><vertices id="v">'
                '<input semantic="POSITION" source="#s"/></vertices><triangles count="1000000000">'
                '<input semantic="VERTEX" source="#v" offset="0"/><p>0 1 999999999</p>'
                "</triangles></mesh>"
                "</geometry></library_geometries>"
            ),
        ),
        ("m.dae",),
    ),
    Hostile(
        "dae-nodes",
        SDF,
        mesh(
            "m.dae",
            collada(
                "<library_nodes>"
                + "".join(
                    f'<node id="n{i}">'
                    + f'<instance_node url="#n{i - 1}"/>' * 10 * bool(i)
                    + "</node>"
                    for i in range(12)
                )
                + '</library_nodes><library_visual_scenes><visual_scene id="s"><node id="t">'
                '<instance_node url="#n11"/></node></visual_scene></library_visual_scenes><scene>'
                '<instance_visual_scene url="#s"/></scene>'
            ),
        ),
        ("m.dae",),
    ),
    Hostile("glb-count", SDF, mesh("m.glb", accessor_glb(2_000_000_000)), ("m.glb",)),
    Hostile(
        "glb-length",
        SDF,
        mesh("m.glb", struct.pack("<4sIIII", b"glTF", 2, 20, 0xFFFFFFFF, 0x4E4F534A)),
        ("m.glb",),
    ),
    Hostile("glb-deep", SDF, mesh("m.glb", glb(DEEP_JSON.encode())), ("m.glb",)),
    Hostile(
        "glb-nodes",
        SDF,
        mesh(
            "m.glb",
            glb(
                {
                    "asset": {"version": "2.0"},
                    "scene": 0,
                    "scenes": [{"nodes": [0]}],
                    "nodes": [{"children": [i + 1] * 10} for i in range(12)] + [{}],
                }
            ),
        ),
        ("m.glb",),
    ),
    Hostile(
        "glb-uri",
        SDF,
        mesh(
            "m.glb",
            glb(
                {
                    "asset": {"version": "2.0"},
                    "buffers": [{"uri": "file:///etc/passwd", "byteLength": 12}],
                    "meshes": [],
                    "nodes": [],
                }
            ),
        ),
        ("m.glb",),
    ),
    Hostile("mesh-passwd", SDF, meshed("file:///etc/passwd"), ("world.sdf",)),
    Hostile("mesh-above", SDF, meshed("../../../../../../etc/passwd"), ("world.sdf",)),
    Hostile("mesh-device", SDF, all_of(meshed("m.stl"), link("m.stl", "/dev/zero")), ("m.stl",)),
    Hostile("mesh-pipe", SDF, all_of(meshed("m.stl"), pipe("m.stl")), ("m.stl",)),
    Hostile("mesh-sparse", SDF, all_of(meshed("m.stl"), sparse("m.stl")), ("m.stl",)),
    Hostile("mesh-empty", SDF, mesh("m.obj", ""), ("m.obj",)),
    # Textures.
    Hostile(
        "texture-bomb",
        SDF,
        textured(text("texture.png", png(100_000, 100_000, 100))),
        ("texture.png",),
    ),
    Hostile(
        "texture-large", SDF, textured(text("texture.png", png(7_900, 7_900, 7_900))), (), (0, 1)
    ),
    Hostile(
        "texture-cut",
        SDF,
        textured(text("texture.png", png(64, 64, 10, end=False))),
        ("texture.png",),
    ),
    Hostile("texture-device", SDF, textured(link("texture.png", "/dev/zero")), ("texture.png",)),
    Hostile("texture-pipe", SDF, textured(pipe("texture.png")), ("texture.png",)),
    Hostile(
        "texture-sparse",
        SDF,
        textured(sparse("texture.png", b"\x89PNG\r\n\x1a\n")),
        ("texture.png",),
    ),
    Hostile(
        "texture-tiff",
        SDF,
        textured(
            text("texture.png", b"II*\0\x08\0\0\0\x01\0" + struct.pack("<HHII", 256, 4, 1, 99999))
        ),
        ("texture.png",),
    ),
    # Xacro.
    Hostile(
        "xacro-attribute",
        XACRO,
        evaluated("().__class__.__base__.__subclasses__()"),
        ("world.sdf.xacro",),
    ),
    Hostile("xacro-power", XACRO, evaluated("10**10**10"), ("world.sdf.xacro",)),
    Hostile("xacro-list", XACRO, evaluated("len([0]*10**10)"), ("world.sdf.xacro",)),
    Hostile(
        "xacro-import", XACRO, evaluated("__import__('os').system('id')"), ("world.sdf.xacro",)
    ),
    Hostile("xacro-format", XACRO, evaluated("'{0.__class__}'.format(1)"), ("world.sdf.xacro",)),
    Hostile("xacro-load-yaml", XACRO, evaluated("load_yaml('/etc/passwd')"), ("world.sdf.xacro",)),
    Hostile(
        "xacro-macro",
        XACRO,
        xacro('<xacro:macro name="m"><xacro:m/></xacro:macro><xacro:m/>'),
        ("world.sdf.xacro",),
    ),
    Hostile(
        "xacro-macros",
        XACRO,
        xacro(
            "".join(
                f'<xacro:macro name="m{i}">'
                + (f"<xacro:m{i - 1}/>" * 10 if i else "<a/>")
                + "</xacro:macro>"
                for i in range(9)
            )
            + "<xacro:m8/>"
        ),
        ("world.sdf.xacro",),
    ),
    Hostile(
        "xacro-include",
        XACRO,
        xacro('<xacro:include filename="world.sdf.xacro"/>'),
        ("world.sdf.xacro",),
    ),
    Hostile(
        "xacro-passwd",
        XACRO,
        xacro('<xacro:include filename="/etc/passwd"/>'),
        ("world.sdf.xacro",),
    ),
    Hostile(
        "xacro-laughs",
        XACRO,
        text(
            "world.sdf.xacro",
            f"<!DOCTYPE a [{BOMB_ENTITIES}]><sdf "
            'xmlns:xacro="http://www.ros.org/wiki/xacro">&e9;</sdf>',
        ),
        ("world.sdf.xacro",),
    ),
    # Maps.
    Hostile(
        "map-bomb",
        PLAN,
        map_of("m.png", text("m.png", png(100_000, 100_000, 100))),
        ("map.yaml", "image", "pixels"),
    ),
    Hostile(
        "map-pgm-lie",
        PLAN,
        map_of("m.pgm", text("m.pgm", b"P5 4000 4000 255\n\0\0")),
        ("map.yaml", "image", "corrupt"),
    ),
    Hostile(
        "map-pgm-huge",
        PLAN,
        map_of("m.pgm", text("m.pgm", b"P5 99999999999 99999999999 255\n")),
        ("map.yaml", "image"),
    ),
    Hostile(
        "map-plain-lie",
        PLAN,
        map_of("m.pgm", text("m.pgm", b"P2 4000 4000 255\n1 2 3")),
        ("map.yaml", "image", "corrupt"),
    ),
    Hostile(
        "map-plain-wide",
        PLAN,
        map_of("m.pgm", text("m.pgm", b"P2 4 4 255\n" + b"1 " * 40_000_000)),
        ("map.yaml", "image"),
    ),
    Hostile("map-passwd", PLAN, map_of("../../../../../../../etc/passwd"), ("map.yaml", "image")),
    Hostile("map-device", PLAN, map_of("/dev/zero"), ("map.yaml", "image", "file")),
    Hostile("map-pipe", PLAN, map_of("m.pgm", pipe("m.pgm")), ("map.yaml", "image", "file")),
    Hostile("map-proc", PLAN, map_of("/proc/self/mem"), ("map.yaml", "image")),
    Hostile(
        "map-sparse",
        PLAN,
        map_of("m.pgm", sparse("m.pgm", b"P5 4000 4000 255\n")),
        ("map.yaml", "image", "bytes"),
    ),
    Hostile("map-escapes", PLAN, map_of('"\\e[2Jx.pgm"'), ("map.yaml", "image")),
    Hostile("map-long-name", PLAN, map_of("x" * 5000), ("map.yaml", "image")),
    Hostile(
        "map-infinite",
        PLAN,
        text("map.yaml", "image: m.pgm\nresolution: 1e400\norigin: [.nan, .inf, 0]\n"),
        ("map.yaml", "resolution"),
    ),
    # Nav2's parameters, settings.
    Hostile("params-aliases", PARAMS, text("nav2.yaml", ALIASES), ("nav2.yaml",)),
    Hostile(
        "params-alias-leaves",
        PARAMS,
        text(
            "nav2.yaml",
            "y0: &y0 {k: 1}\n"
            + "".join(
                f"y{i}: &y{i} {{{', '.join(f'k{j}: *y{i - 1}' for j in range(9))}}}\n"
                for i in range(1, 9)
            )
            + "amcl: {ros__parameters: *y8}\n",
        ),
        ("nav2.yaml",),
    ),
    Hostile(
        "params-merges",
        PARAMS,
        text("nav2.yaml", MERGES + "amcl: {ros__parameters: *a9}\n"),
        ("nav2.yaml",),
    ),
    Hostile("params-deep", PARAMS, text("nav2.yaml", DEEP_YAML), ("nav2.yaml",)),
    Hostile(
        "params-tag",
        PARAMS,
        text("nav2.yaml", "!!python/object/apply:os.system [id]"),
        ("nav2.yaml",),
    ),
    Hostile("params-sparse", PARAMS, sparse("nav2.yaml"), ("nav2.yaml", "bytes")),
    Hostile(
        "params-long",
        PARAMS,
        text("nav2.yaml", "amcl: {ros__parameters: {a: " + "1_" * 5_000_000 + "}}"),
        ("nav2.yaml",),
    ),
    Hostile(
        "params-sexagesimal",
        PARAMS,
        text("nav2.yaml", "amcl: {ros__parameters: {alpha1: " + "1:" * 400_000 + "1}}"),
        ("nav2.yaml",),
    ),
    Hostile(
        "params-escapes",
        PARAMS,
        text("nav2.yaml", 'amcl: {ros__parameters: {"\\e[2J\\e]0;x\\a": 1, alpha1: "\\e[2J"}}'),
        ("nav2.yaml",),
    ),
    Hostile(
        "params-device", PARAMS, link("nav2.yaml", "/dev/zero"), ("nav2.yaml", "must be a file")
    ),
    Hostile("config-aliases", CONFIG, text("config.yaml", ALIASES), ("config.yaml",)),
    Hostile("config-deep", CONFIG, text("config.yaml", DEEP_YAML), ("config.yaml",)),
    Hostile(
        "config-tag",
        CONFIG,
        text("config.yaml", "a: !!python/name:os.system x"),
        ("config.yaml:1", "tag"),
    ),
    Hostile("config-sparse", CONFIG, sparse("config.yaml"), ("config.yaml", "bytes")),
    Hostile(
        "config-sexagesimal",
        CONFIG,
        text("config.yaml", "seed: " + "1:" * 400_000 + "1"),
        ("config.yaml",),
    ),
    Hostile(
        "config-timestamp",
        CONFIG,
        text("config.yaml", "physics: {scan_rate_hz: 2001-99-99}"),
        ("config.yaml",),
    ),
    Hostile(
        "config-escapes",
        CONFIG,
        text("config.yaml", '"\\e[2J\\e]0;x\\a": {a: 1}'),
        ("config.yaml",),
    ),
    # Behaviour trees.
    Hostile(
        "tree-laughs",
        TREE,
        tree("&e9;", f"<!DOCTYPE a [{BOMB_ENTITIES}]>"),
        ("tree.xml", "DOCTYPE"),
    ),
    Hostile("tree-deep", TREE, tree("<a>" * 100_000), ("tree.xml", "deep")),
    Hostile("tree-wide", TREE, tree("<a/>" * 1_000_000), ("tree.xml",)),
    Hostile(
        "tree-subtrees",
        TREE,
        text(
            "tree.xml",
            '<root BTCPP_format="4" main_tree_to_execute="t11">'
            + "".join(
                f'<BehaviorTree ID="t{i}"><Sequence>'
                + (f'<SubTree ID="t{i - 1}"/>' * 10 if i else "<AlwaysSuccess/>")
                + "</Sequence></BehaviorTree>"
                for i in range(12)
            )
            + "</root>",
        ),
        ("tree.xml", "elements"),
    ),
    Hostile(
        "tree-subtree-chain",
        TREE,
        text(
            "tree.xml",
            '<root BTCPP_format="4" main_tree_to_execute="t1999">'
            + "".join(
                f'<BehaviorTree ID="t{i}">'
                + (f'<SubTree ID="t{i - 1}"/>' if i else "<AlwaysSuccess/>")
                + "</BehaviorTree>"
                for i in range(2000)
            )
            + "</root>",
        ),
        ("tree.xml", "deep"),
    ),
    Hostile(
        "tree-itself",
        TREE,
        tree('<BehaviorTree ID="a"><SubTree ID="a"/></BehaviorTree>'),
        ("tree.xml",),
    ),
    Hostile("tree-pipe", TREE, pipe("tree.xml"), ("tree.xml", "must be a file")),
    Hostile("tree-device", TREE, link("tree.xml", "/dev/zero"), ("tree.xml", "must be a file")),
    Hostile("tree-sparse", TREE, sparse("tree.xml"), ("tree.xml", "bytes")),
    Hostile(
        "tree-script",
        TREE,
        tree('<BehaviorTree ID="a"><Script code="' + "(" * 100_000 + '"/></BehaviorTree>'),
        ("tree.xml",),
    ),
    # Logs and recordings.
    Hostile(
        "carmen-beams",
        log_of("a.log"),
        text("a.log", "FLASER 1000000000 1 2 3\nFLASER 1 1\n"),
        ("a.log:1", "num_readings"),
    ),
    Hostile(
        "carmen-infinite",
        log_of("a.log"),
        text("a.log", "FLASER 1 1 nan 0 0 0 0 inf 1 h 1\nODOM 1e400 0 0\n"),
        ("a.log:1",),
    ),
    Hostile(
        "carmen-long", log_of("a.log"), text("a.log", "FLASER " + "1 " * 15_000_000), ("a.log",)
    ),
    Hostile(
        "carmen-escapes",
        log_of("a.log"),
        text("a.log", f"FLASER {ESCAPES}\nODOM 1\n"),
        ("a.log:1",),
    ),
    Hostile(
        "csv-columns",
        log_of("a.csv"),
        text("a.csv", "time_s,odom_x_m,odom_y_m,odom_yaw_rad," + "range_0," * 1_000_000),
        ("a.csv",),
    ),
    Hostile(
        "csv-time",
        log_of("a.csv"),
        text("a.csv", "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0\n1e300,0,0,0,1\n"),
        ("a.csv:2", "time_s"),
    ),
    Hostile(
        "log-gzip-bomb", log_of("a.log.gz"), gzip_file("a.log.gz", b"FLASER 1 ", 400), ("a.log.gz",)
    ),
    Hostile("log-device", log_of("a.log"), link("a.log", "/dev/zero"), ("a.log",)),
    Hostile("log-pipe", log_of("a.log"), pipe("a.log"), ("a.log", "must be a file")),
    Hostile("log-sparse", log_of("a.log"), sparse("a.log", b"FLASER 1 2\n"), ("a.log",)),
    Hostile(
        "relations-sparse",
        ("map", "build", "--log", "a.csv", "--out", "new", "--relations", "relations"),
        all_of(
            sparse("relations"),
            text("a.csv", "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0\n1,0,0,0,1\n"),
        ),
        ("relations", "bytes"),
    ),
    Hostile(
        "relations-device",
        ("map", "build", "--log", "a.csv", "--out", "new", "--relations", "relations"),
        all_of(
            link("relations", "/dev/zero"),
            text("a.csv", "time_s,odom_x_m,odom_y_m,odom_yaw_rad,range_0\n1,0,0,0,1\n"),
        ),
        ("relations", "must be a file"),
    ),
    Hostile(
        "mcap-record-length",
        log_of("a.mcap"),
        text("a.mcap", mcap.MAGIC + struct.pack("<BQ", mcap.CHUNK, 1 << 63) + bytes(64)),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-channel-length",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(mcap.record(mcap.CHANNEL, struct.pack("<HHI", 1, 1, 0xFFFFFFFF)))),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-zstd-bomb",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(scan_channel(), zstd_bomb(400, 400 * len(_ZEROS)))),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-zstd-lie",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(scan_channel(), zstd_bomb(400, 100))),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-zstd-cut",
        log_of("a.mcap"),
        text(
            "a.mcap", mcap.MAGIC + mcap.header("", "") + scan_channel() + zstd_bomb(400, 100)[:-9]
        ),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-lz4-bomb",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(scan_channel(), lz4_bomb(400, 100))),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-lz4-cut",
        log_of("a.mcap"),
        text("a.mcap", mcap.MAGIC + mcap.header("", "") + scan_channel() + lz4_bomb(400, 100)[:-9]),
        ("a.mcap",),
    ),
    Hostile(
        "ros1-bz2-bomb",
        log_of("a.bag"),
        text("a.bag", ros1_bomb(400)),
        ("a.bag", "must unpack to at most"),
    ),
    Hostile(
        "mcap-scan-count",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(scan_channel(), message(cdr_scan(1_000_000_000)))),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-message-bomb",
        log_of("a.mcap"),
        text(
            "a.mcap",
            mcap_file(
                scan_channel(),
                message(zstandard.ZstdCompressor(level=1).compress(bytes(400 << 20))),
            ),
        ),
        ("a.mcap",),
    ),
    Hostile(
        "mcap-escapes",
        log_of("a.mcap"),
        text("a.mcap", mcap_file(mcap.channel_record(mcap.Channel(1, 0, ESCAPES, "cdr", {})))),
        ("a.mcap",),
    ),
    Hostile("mcap-sparse", log_of("a.mcap"), sparse("a.mcap", mcap.MAGIC), ("a.mcap",)),
    Hostile("mcap-pipe", log_of("a.mcap"), pipe("a.mcap"), ("a.mcap", "must be a file")),
    Hostile(
        "mcap-packed-bomb",
        log_of("a.mcap.zstd"),
        zstd_file("a.mcap.zstd", mcap.MAGIC, 600),
        ("a.mcap.zstd",),
    ),
    Hostile(
        "db3-view",
        log_of("bag.db3"),
        database(
            "CREATE VIEW topics AS " + ENDLESS + "SELECT i AS id, '/a' AS name, 'b' AS type, "
            "'cdr' AS serialization_format FROM n"
        ),
        ("bag.db3",),
    ),
    Hostile(
        "db3-messages-view",
        log_of("bag.db3"),
        database(
            *TOPICS,
            "CREATE VIEW messages AS "
            + ENDLESS
            + "SELECT i AS id, 1 AS topic_id, i AS timestamp, zeroblob(1000000) AS data FROM n",
        ),
        ("bag.db3",),
    ),
    Hostile("db3-schema", log_of("bag.db3"), database("CREATE TABLE topics(a)"), ("bag.db3",)),
    Hostile(
        "db3-types",
        log_of("bag.db3"),
        database(
            TOPICS[0],
            "INSERT INTO topics VALUES('x', x'00ff', 3.5, NULL)",
            "CREATE TABLE messages(id, topic_id, timestamp, data)",
            "INSERT INTO messages VALUES(1, 'x', 'soon', NULL)",
        ),
        ("bag.db3",),
    ),
    Hostile(
        "db3-blob",
        log_of("bag.db3"),
        database(
            *TOPICS,
            "CREATE TABLE messages(id, topic_id, timestamp, data)",
            "INSERT INTO messages VALUES(1, 1, 'soon', 'text')",
        ),
        ("bag.db3",),
    ),
    Hostile(
        "db3-cut", log_of("a.db3"), text("a.db3", b"SQLite format 3\0" + b"\xff" * 2000), ("a.db3",)
    ),
    Hostile(
        "bag-aliases",
        log_of("bag"),
        all_of(text("bag/metadata.yaml", ALIASES), text("bag/a.mcap", mcap_file())),
        ("bag",),
    ),
    Hostile(
        "bag-deep",
        log_of("bag"),
        all_of(text("bag/metadata.yaml", DEEP_YAML), text("bag/a.mcap", mcap_file())),
        ("bag",),
    ),
    Hostile(
        "bag-sparse",
        log_of("bag"),
        all_of(text("bag/a.mcap", mcap_file()), sparse("bag/metadata.yaml")),
        ("bag",),
    ),
    Hostile(
        "bag-outside",
        log_of("bag"),
        all_of(
            text("outside.mcap", mcap_file(scan_channel())),
            text(
                "bag/metadata.yaml",
                "rosbag2_bagfile_information: {relative_file_paths: "
                "[../outside.mcap, /etc/passwd]}",
            ),
        ),
        ("outside.mcap", "missing"),
    ),
    Hostile(
        "bag-link",
        log_of("bag"),
        all_of(subfolder("bag"), link("bag/a.mcap", "/dev/zero")),
        ("bag",),
    ),
    Hostile(
        "bag-names",
        log_of("bag"),
        text(
            "bag/metadata.yaml",
            'rosbag2_bagfile_information: {relative_file_paths: ["\\e[2J.mcap", "a\\0b"]}',
        ),
        ("bag",),
    ),
    Hostile("run-summary-deep", INFO, run(summary=DEEP_JSON), ("summary.json: recursion",), (0,)),
    Hostile(
        "run-summary-number",
        INFO,
        run(summary='{"seed": ' + "9" * 100_000 + "}"),
        ("summary.json: number",),
        (0,),
    ),
    Hostile(
        "run-summary-sparse",
        INFO,
        all_of(run(), sparse("runs/r/summary.json")),
        ("summary.json: must have",),
        (0,),
    ),
    Hostile("run-summary-pipe", INFO, all_of(run(), pipe("runs/r/summary.json")), (), (0,)),
    Hostile(
        "run-summary-device",
        INFO,
        all_of(run(), link("runs/r/summary.json", "/dev/zero")),
        (),
        (0,),
    ),
    Hostile(
        "run-summary-escapes",
        INFO,
        run(summary='{"world": "\\u001b[2J\\u001b]0;x\\u0007"}'),
        ("x1b[2J",),
        (0,),
    ),
    Hostile("run-config-aliases", COMPARE, run(summary="{}", config=ALIASES), ("config.yaml",)),
    Hostile("run-config-deep", COMPARE, run(summary="{}", config=DEEP_YAML), ("config.yaml",)),
    Hostile(
        "run-config-sparse",
        COMPARE,
        all_of(run(summary="{}"), sparse("runs/r/config.yaml")),
        ("config.yaml", "bytes"),
    ),
    Hostile("run-labels-flat", INFO, run(summary="{}", labels=_FLAT), ("labels.json",), (0,)),
    Hostile(
        "run-labels-pipe", INFO, all_of(run(summary="{}"), pipe("runs/r/labels.json")), (), (0,)
    ),
    Hostile(
        "run-digests-sparse",
        DIFF,
        all_of(run(summary="{}"), sparse("runs/r/digests.bin")),
        ("digests.bin",),
    ),
    Hostile(
        "run-digests-pipe",
        DIFF,
        all_of(run(summary="{}"), pipe("runs/r/digests.bin")),
        ("digests.bin",),
    ),
    Hostile(
        "replay-mcap-bomb",
        ("replay", "a.mcap", "--duration", "1"),
        text("a.mcap", mcap_file(scan_channel(), zstd_bomb(400, 400 * len(_ZEROS)))),
        ("a.mcap",),
    ),
    Hostile("replay-pipe", ("replay", "a.mcap"), pipe("a.mcap"), ("a.mcap",)),
    Hostile("graph-deep", ("graph", "g.json"), text("g.json", DEEP_JSON), ("g.json",)),
    Hostile("graph-sparse", ("graph", "g.json"), sparse("g.json"), ("g.json", "bytes")),
    # Images and cameras.
    Hostile(
        "picture-bomb",
        DETECT,
        text("picture.png", png(100_000, 100_000, 100)),
        ("picture.png", "pixels"),
    ),
    Hostile(
        "picture-large",
        DETECT,
        text("picture.png", png(9_000, 9_000, 9_000)),
        ("picture.png", "pixels"),
    ),
    Hostile(
        "picture-cut", DETECT, text("picture.png", png(64, 64, 9, end=False)), ("picture.png",)
    ),
    Hostile("picture-sparse", DETECT, sparse("picture.png", b"\x89PNG"), ("picture.png", "bytes")),
    Hostile("picture-pipe", DETECT, pipe("picture.png"), ("picture.png", "must be a file")),
    Hostile(
        "camera-aliases", CAMERA, all_of(_PICTURE, text("camera.yaml", ALIASES)), ("camera.yaml",)
    ),
    Hostile(
        "camera-sexagesimal",
        CAMERA,
        all_of(_PICTURE, text("camera.yaml", "image_width: " + "1:" * 300_000 + "1")),
        ("camera.yaml",),
    ),
    Hostile(
        "camera-tag",
        CAMERA,
        all_of(_PICTURE, text("camera.yaml", "a: !!python/object/apply:os.system [id]")),
        ("camera.yaml", "tag"),
    ),
    Hostile(
        "dictionary-laughs",
        DICTIONARY,
        all_of(_PICTURE, text("codes.yml", f"<!DOCTYPE a [{BOMB_ENTITIES}]><a><b>&e9;</b></a>")),
        ("codes.yml",),
    ),
    Hostile(
        "dictionary-deep",
        DICTIONARY,
        all_of(_PICTURE, text("codes.yml", DEEP_JSON)),
        ("codes.yml",),
    ),
    Hostile("dictionary-sparse", DICTIONARY, all_of(_PICTURE, sparse("codes.yml")), ("codes.yml",)),
    Hostile("dictionary-pipe", DICTIONARY, all_of(_PICTURE, pipe("codes.yml")), ("codes.yml",)),
    Hostile(
        "waypoints-aliases", ("waypoints", "./w.yaml"), text("w.yaml", ALIASES), ("w.yaml", "alias")
    ),
    Hostile(
        "waypoints-device", ("waypoints", "./w.yaml"), link("w.yaml", "/dev/zero"), ("w.yaml",)
    ),
)
