"""The command: what it prints, and that every mistake is one line and no exit code 0."""

import contextlib
import io
import json
import os
import re
import socket
import subprocess
import sys
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
import yaml

from mazebot.bench.parts.loopback_router import free_port, running_router
from mazebot.cli.app import main
from mazebot.cli.demo import parse_bool
from mazebot.cli.topics.topic import in_json, plain
from mazebot.common.config import ConfigError
from mazebot.common.files.version import mazebot_version
from mazebot.common.messages.messages import matrix_from_pose
from mazebot.common.messages.topics import GOAL_POSE, SCAN, WORLD
from tests.common.samples import SAMPLES

NO_GL = {
    "EGL_PLATFORM": "surfaceless",
    "__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent",
    "__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent/none.json",
}


RECORDING_OF_NOTHING = b"RRF2" + bytes(8) + b"RRF2FOOT" + bytes(4)
THREADS = "OPENBLAS_NUM_THREADS"
WRITTEN = (
    "/cmd_vel", "/cmd_vel_teleop", "/controller_selector", "/explore/resume", "/goal_pose",
    "/goal_update", "/initialpose", "/planner_selector", "/speed_limit",
)  # fmt: skip
"""The topics of the user's tools."""


def mazebot(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """The command in this process."""
    out, err = io.StringIO(), io.StringIO()
    with (
        mock.patch.object(sys, "argv", ["mazebot", *arguments]),
        mock.patch.dict(os.environ, environment),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        pytest.raises(SystemExit) as left,
    ):
        main()
    code = left.value.code
    assert isinstance(code, int)
    return subprocess.CompletedProcess([], code, out.getvalue(), err.getvalue())


def python(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A module in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
        env={**os.environ, **environment},
    )


def assert_one_line(done: subprocess.CompletedProcess[str], *words: str) -> None:
    assert done.returncode != 0
    assert "Traceback" not in done.stderr + done.stdout
    lines = [line for line in done.stderr.splitlines() if line]
    assert len(lines) == 1, done.stderr
    for word in words:
        assert word in lines[0]


def test_help_names_every_command() -> None:
    done = mazebot("--help")
    assert done.returncode == 0
    for name in ("demo", "goal", "sim", "topic", "recordings"):
        assert name in done.stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["goal", "nan", "0", "--json"],
        ["recordings", "info", "nope", "--json"],
        ["demo", "--json", "--seed", "-1"],
        ["topic", "info", "/nope", "--json"],
    ],
)
def test_with_json_a_mistake_is_json_as_well(arguments: list[str]) -> None:
    done = mazebot(*arguments)
    assert_one_line(done)
    said = json.loads(done.stdout)
    assert said == {"error": done.stderr.removeprefix("error: ").strip(), "exit_code": 2}
    assert done.returncode == 2


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["demo", "--nope"], ["--nope"]),
        (["nope"], ["nope"]),
        (["demo", "--seed", "-1"], ["--seed"]),
        (["demo", "--renderer", "magic", "--no-record"], ["renderer", "magic"]),
        (["demo", "--use_aruco", "maybe"], ["--use_aruco", "maybe"]),
        (["goal", "nan", "0", "0"], ["X", "nan"]),
        (["goal", "0", "inf", "0"], ["Y", "inf"]),
        (["topic", "hz", "/nope"], ["/nope"]),
        (["recordings", "view", "nope"], ["nope"]),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], words: list[str]) -> None:
    assert_one_line(mazebot(*arguments), *words)


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        (["demo", "--world", "enh"], {"enhanced"}),
        (["topic", "echo", "/scan"], {"/scan"}),
        (["topic", "hz", "/od"], {"/odom"}),
        (["topic", "pub", "/"], set(WRITTEN)),
        (["world", "sho"], {"show"}),
        (["world", "show", "maze"], {"maze", "maze_rooms"}),
        (["recordings", "view", "2026"], {"2026-01-02_03-04-05_sim_house"}),
        (["demo", "--renderer", "g"], {"gl"}),
        (["replay", "2026"], {"2026-01-02_03-04-05_sim_house"}),
        (["replay", "--service", "nav"], {"navigation"}),
        (["replay", "--only", "/od"], {"/odom"}),
    ],
)
def test_the_shell_completes_commands_and_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], offered: set[str]
) -> None:
    run = tmp_path / "recordings" / "2026-01-02_03-04-05_sim_house"
    run.mkdir(parents=True)
    (run / "config.yaml").touch()
    monkeypatch.chdir(tmp_path)
    done = mazebot(
        _MAZEBOT_COMPLETE="complete_bash",
        COMP_WORDS=" ".join(["mazebot", *words]),
        COMP_CWORD=str(len(words)),
    )
    assert set(done.stdout.split()) == offered


@pytest.mark.parametrize(
    "arguments", [["--version"], ["recordings", "list"], ["map", "--help"], ["ps"], ["down"]]
)
def test_a_short_command_loads_neither_the_compiler_nor_the_bus(
    arguments: list[str], tmp_path: Path
) -> None:
    code = (
        "import contextlib, sys\n"
        "from mazebot.cli.app import main\n"
        "sys.argv = ['mazebot', *sys.argv[1:]]\n"
        "with contextlib.suppress(SystemExit):\n"
        "    main()\n"
        "loaded = {'numba', 'zenoh', 'pybullet', 'cv2', 'rerun'} & set(sys.modules)\n"
        "sys.exit(', '.join(sorted(loaded)) or 0)"
    )
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, timeout=60, check=False,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_a_command_starts_no_threads_of_numpy_unless_it_is_told_to() -> None:
    code = (
        "import atexit, os, sys\n"
        "from mazebot.cli.__main__ import main\n"
        "sys.argv = ['mazebot', '--version']\n"
        "atexit.register(lambda: print(len(os.listdir('/proc/self/task'))))\n"
        "main()\n"
    )
    plain = {name: value for name, value in os.environ.items() if name != THREADS}
    for environment, threads in ((plain, "1"), ({**plain, THREADS: "2"}, "2")):
        command = [sys.executable, "-c", code]
        done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment)
        assert done.stdout.splitlines()[-1] == threads


def test_the_version_is_told() -> None:
    told = mazebot("--version").stdout
    assert re.fullmatch(r"mazebot \d+\.\d+\.\d+\n", told)
    assert told == f"mazebot {mazebot_version()}\n"


@pytest.mark.parametrize(("word", "code"), [("--version", 0), ("nonsense", 2)])
def test_with_zenoh_s_threads_the_exit_code_does_not_depend_on_how_python_is_taken_down(
    word: str, code: int
) -> None:
    script = (
        "import atexit, os, sys, zenoh\n"
        "from mazebot.cli.__main__ import main\n"
        "atexit.register(os.abort)\n"
        f"sys.argv = ['mazebot', {word!r}]\n"
        "main()\n"
    )
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert done.stdout + done.stderr


def test_a_recording_is_opened_in_a_browser_where_there_is_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = mock.Mock(return_value=True)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.rrd").write_bytes(RECORDING_OF_NOTHING)
    port = str(free_port())
    monkeypatch.setattr("threading.Event.wait", mock.Mock(side_effect=KeyboardInterrupt))
    monkeypatch.setattr("mazebot.recorder.keeping.live.WebPage", mock.Mock())
    monkeypatch.setattr("webbrowser.open", opened)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    view = ("recordings", "view", str(tmp_path / "run"), "--port", port)
    for words, environment, told, browsers in (
        ((), {"DISPLAY": ":0"}, f"open http://localhost:{port} in a browser", 0),
        (("--open",), {}, f"open http://localhost:{port} in a browser", 0),
        (("--open",), {"DISPLAY": ":0"}, f"opened http://localhost:{port} in your browser", 1),
    ):
        done = mazebot(*view, *words, **environment)
        assert told in done.stdout
        assert opened.call_count == browsers


@pytest.mark.parametrize("words", [(), ("latest",), ("2026-01-01_00-00-00_a",)])
def test_the_newest_run_with_a_recording_is_shown_unless_another_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...]
) -> None:
    for name, file in (
        ("2026-01-01_00-00-00_a", "run.rrd"),
        ("2026-01-02_00-00-00_b", "run.rrd"),
        ("2026-01-03_00-00-00_c", "summary.json"),
    ):
        (tmp_path / name).mkdir()
        (tmp_path / name / file).write_bytes(RECORDING_OF_NOTHING)
    monkeypatch.setattr("threading.Event.wait", mock.Mock(side_effect=KeyboardInterrupt))
    page = mock.Mock()
    monkeypatch.setattr("mazebot.recorder.keeping.live.WebPage", page)
    mazebot("recordings", "view", *words, "--dir", str(tmp_path), "--port", str(free_port()))
    expected = words[0] if words and words[0] != "latest" else "2026-01-02_00-00-00_b"
    assert page.call_args.kwargs["recording"] == [tmp_path / expected / "run.rrd"]
    assert_one_line(mazebot("recordings", "view", "2026-01-03_00-00-00_c", "--dir", str(tmp_path)),
                    "2026-01-03_00-00-00_c", "run.rrd")  # fmt: skip


def test_runs_are_listed_in_json(tmp_path: Path) -> None:
    run = tmp_path / "2026-01-02_03-04-05_sim_house"
    run.mkdir()
    (run / "summary.json").write_text(json.dumps({"world": "sim_house", "goals": []}))
    (listed,) = json.loads(mazebot("recordings", "list", "--dir", str(tmp_path), "--json").stdout)
    assert (listed["name"], listed["started"]) == (run.name, "2026-01-02T03:04:05")
    assert json.loads(mazebot("recordings", "list", "--dir", str(run), "--json").stdout) == []


def test_without_a_stack_the_router_is_named() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert_one_line(mazebot("goal", "0", "0", "0", "--connect", endpoint), endpoint)
    assert_one_line(mazebot("topic", "list", "--connect", endpoint), endpoint)


def test_without_a_stack_every_way_to_start_one_is_named() -> None:
    done = mazebot("goal", "0", "0", MAZEBOT_BUS_CONNECT=f"tcp/127.0.0.1:{free_port()}")
    ways = ("docker compose up demo-world-enhanced", "mazebot demo --console", "mazebot up")
    assert_one_line(done, "no Zenoh router", *ways)


def test_a_router_without_a_robot_is_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mazebot.cli.drive.task.PATIENCE_S", 0.5)
    with running_router() as endpoint:
        done = mazebot("goal", "1", "-2", "0", "--connect", endpoint)
    assert_one_line(done, "no navigation service")


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.rrd").write_bytes(RECORDING_OF_NOTHING)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        done = mazebot("recordings", "view", str(tmp_path / "run"), "--port", port)
        router = python("mazebot.router", "--listen", f"tcp/127.0.0.1:{port}")
    assert_one_line(done, port)
    assert_one_line(router, port)


@pytest.mark.slow
def test_no_gl_is_one_line(tmp_path: Path) -> None:
    flags = ["--renderer", "gl", "--out", str(tmp_path / "run")]
    done = python("mazebot.cli", "demo", *flags, **NO_GL)
    assert_one_line(done, "renderer", "gl")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ({"walls": [{"length_m": -1}]}, ["length_m", "-1"]),
        ({"walls": [{"length_m": float("nan")}]}, ["length_m", "nan"]),
        ({"nope": 1}, ["nope"]),
    ],
)
def test_a_bad_recipe_names_file_field_and_value(
    tmp_path: Path, recipe: dict[str, object], words: list[str]
) -> None:
    source = Path(__file__).parents[2] / "worlds" / "sim_house.yaml"
    content = yaml.safe_load(source.read_text())
    if "walls" in recipe:
        content["walls"][3].update(recipe["walls"][0])  # type: ignore[index]
    else:
        content.update(recipe)
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(content, sort_keys=False))
    done = mazebot(
        "demo", "--world", "bad", "--no-camera", "--no-record", "--out", str(tmp_path / "run"),
        MAZEBOT_WORLDGEN_WORLDS_DIR=str(tmp_path),
    )  # fmt: skip
    assert_one_line(done, "bad.yaml", *words)
    assert not (tmp_path / "run").exists()


def test_an_unknown_world_names_the_known_ones(tmp_path: Path) -> None:
    done = mazebot("demo", "--world", "atlantis", "--no-record", "--out", str(tmp_path / "run"))
    assert_one_line(done, "atlantis", "sim_house_enhanced")


def test_a_missing_texture_is_named(tmp_path: Path) -> None:
    done = mazebot(
        "demo", "--texture_base", str(tmp_path), "--no-record", "--out", str(tmp_path / "run")
    )
    assert_one_line(done, "bricks.png")


def test_a_folder_that_holds_a_run_is_not_written_over(tmp_path: Path) -> None:
    (tmp_path / "summary.json").write_text("{}")
    assert_one_line(mazebot("demo", "--out", str(tmp_path)), "summary.json")
    assert (tmp_path / "summary.json").read_text() == "{}"


def test_recordings_are_listed(tmp_path: Path) -> None:
    run = tmp_path / "2026-01-02_03-04-05_sim_house"
    run.mkdir()
    goals = [{"reached": True}, {"reached": False}]
    (run / "summary.json").write_text(json.dumps({"world": "sim_house", "goals": goals}))
    done = mazebot("recordings", "list", "--dir", str(tmp_path))
    assert done.returncode == 0
    assert "2026-01-02_03-04-05_sim_house" in done.stdout
    assert "1/2" in done.stdout


@pytest.mark.parametrize(("text", "value"), [("True", True), ("false", False), ("1", True)])
def test_booleans_are_those_of_launch_files(text: str, value: bool) -> None:
    assert parse_bool("--use_aruco", text) is value


def test_a_boolean_that_is_none() -> None:
    with pytest.raises(ConfigError, match="maybe"):
        parse_bool("--use_aruco", "maybe")


def test_messages_are_shown_as_plain_yaml() -> None:
    shown = yaml.safe_load(yaml.safe_dump(plain(SAMPLES[GOAL_POSE])))
    assert shown["header"]["frame_id"] == "map"
    assert shown["pose"]["position"]["x"] == matrix_from_pose(SAMPLES[GOAL_POSE].pose)[0, 3]
    assert plain(SAMPLES[WORLD])["walls"][0]["name"] == "Wall_0"
    scan = plain(SAMPLES[SCAN])
    assert scan["ranges"][1] == np.inf


def test_messages_are_shown_in_json_with_words_for_what_is_no_number() -> None:
    scan = json.loads(json.dumps(in_json(SAMPLES[SCAN]), allow_nan=False))
    assert scan["ranges"][1] == "Infinity"
    assert len(scan["ranges"]) == len(SAMPLES[SCAN].ranges)
