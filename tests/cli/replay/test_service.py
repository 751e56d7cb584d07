"""One service against a recording: the same to the last bit, or the first difference."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from mazebot.common.messages import messages as msg
from mazebot.common.messages import wire
from mazebot.common.messages.topics import BY_NAME, CAMERA_COMPRESSED, CAMERA_IMAGE
from mazebot.common.recordings.mcap.mcap_channels import definition_of
from mazebot.common.recordings.mcap.mcap_file import McapFile
from mazebot.common.recordings.mcap.mcap_messages import (
    MADE_FROM,
    SOURCE,
    WORLD_HASH,
    read_messages,
)
from mazebot.common.recordings.mcap.mcap_scan import scan
from mazebot.common.recordings.run_folder import LOCK
from tests.cli.replay import runs
from tests.cli.test_app import mazebot
from tests.worldgen import folder as worlds

_PAIRS = {
    "navigation": "/cmd_vel", "localization": "/tf", "spawner": "/entities/desired",
    "worldgen": "/map", "bringup": "/goal_pose", "physics": "/odom",
}  # fmt: skip


def replayed(folder: Path, service: str, *options: str, code: int = 0) -> dict[str, Any]:
    """What the command prints as JSON."""
    done = mazebot("replay", str(folder), "--service", service, "--json", *options)
    assert (done.returncode, done.stderr) == (code, "")
    told: dict[str, Any] = json.loads(done.stdout)
    return told


def rewritten(source: Path, folder: Path, change: Any) -> Path:
    """A run with its messages as `change` gives them back, or without those it gives None for."""
    folder.mkdir()
    shutil.copy(source / "config.yaml", folder)
    file = McapFile(folder / "run.mcap")
    file.add_metadata("mazebot", {})
    ids: dict[tuple[str, ...], int] = {}
    rows = []
    for message in read_messages([source / "run.mcap"]):
        changed = change(message)
        if changed is None:
            continue
        envelope = changed.envelope
        key = (changed.topic, changed.type_name, envelope.source, envelope.world_hash)
        if key not in ids:
            ids[key] = len(ids)
            texts = {SOURCE: key[2], WORLD_HASH: key[3], MADE_FROM: changed.made_from}
            file.add_channel(key[0], key[1], definition_of(key[1]), texts)
        times_ns = (changed.time_ns, envelope.sent_ns)
        rows.append((ids[key], envelope.sequence, *times_ns, (changed.data,)))
    # In two chunks.
    half = len(rows) // 2
    file.add_messages(rows[:half])
    file.add_messages(rows[half:])
    file.close()
    return folder


@pytest.mark.parametrize("service", _PAIRS)
def test_a_service_repeats_what_was_recorded_to_the_last_bit(
    run_folder: Path, service: str
) -> None:
    told = replayed(run_folder, service)
    topics = {row["topic"]: row for row in told["topics"]}
    row = topics[_PAIRS[service]]
    assert told["same"]
    assert row["recorded"] == row["replayed"] == row["same"] > 0
    summary = json.loads((run_folder / "summary.json").read_text())
    assert told["end_s"] == pytest.approx(summary["sim_time_s"])


def test_a_changed_setting_shows_its_effect_and_where_it_begins(run_folder: Path) -> None:
    setting = ("--set", "max_linear_vel=0.2")
    told = replayed(run_folder, "navigation", *setting, code=1)
    assert told["settings"] == {"controller_server.max_linear_vel": [0.46, 0.2]}
    (row,) = [row for row in told["topics"] if row["topic"] == "/cmd_vel"]
    first = row["first_difference"]
    assert row["same"] < row["recorded"]
    assert first["field"].startswith("twist.")
    assert row["largest_differences"]["twist.linear.x"] > 0.05
    done = mazebot("replay", str(run_folder), "--service", "navigation", *setting)
    assert done.returncode == 1
    assert "navigation.controller_server.max_linear_vel: 0.46 recorded, 0.2 here" in done.stdout
    assert f"first difference: {first['time_s']:.3f} s" in done.stdout


def test_a_settings_file_wins_over_the_recording_and_the_option_over_both(
    run_folder: Path, tmp_path: Path
) -> None:
    path = tmp_path / "settings.yaml"
    checker = "general_goal_checker: {xy_goal_tolerance: 0.3}"
    path.write_text(f"navigation: {{controller_server: {{max_linear_vel: 0.2, {checker}}}}}\n")
    options = ("--config", str(path), "--set", "controller_server.max_linear_vel=0.3")
    told = replayed(run_folder, "navigation", *options, code=1)
    checker = "controller_server.general_goal_checker"
    assert told["settings"]["controller_server.max_linear_vel"][1] == 0.3
    assert told["settings"][f"{checker}.xy_goal_tolerance"][1] == 0.3


def test_the_environment_does_not_change_a_replay(
    run_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_NAVIGATION_MAX_LINEAR_VEL", "0.2")
    assert replayed(run_folder, "navigation")["settings"] == {}


def test_a_part_from_the_beginning_is_the_same_too(run_folder: Path) -> None:
    told = replayed(run_folder, "localization", "--duration", "1.03")
    assert told["end_s"] == 1.03
    assert told["same"]
    assert {row["topic"]: row["recorded"] for row in told["topics"]}["/amcl_pose"] == 11


def test_a_later_part_is_the_same_as_the_service_gets_all_before(run_folder: Path) -> None:
    whole, part = (
        {row["topic"]: row for row in replayed(run_folder, "navigation", *options)["topics"]}
        for options in ((), ("--start", "1.2"))
    )
    assert 0 < part["/cmd_vel"]["same"] < whole["/cmd_vel"]["same"]
    assert part["/cmd_vel"]["same"] == part["/cmd_vel"]["recorded"]


def test_a_message_that_is_missing_or_another_is_found(run_folder: Path, tmp_path: Path) -> None:
    def change(message: Any) -> Any:
        if message.topic == "/cmd_vel" and message.envelope.sequence == 7:
            return None
        if message.topic == "/plan":
            return message._replace(data=message.data[:-8] + b"\0\0\0\0\0\0\xe0?")
        return message

    told = replayed(rewritten(run_folder, tmp_path / "other", change), "navigation", code=1)
    firsts = {row["topic"]: row["first_difference"] for row in told["topics"]}
    assert firsts["/cmd_vel"]["message"] == 7
    assert firsts["/cmd_vel"]["only_in"] == "replay"
    assert firsts["/plan"]["field"].endswith("pose.orientation.w")
    assert firsts["/plan"]["recorded"] == "0.5"
    assert firsts["/navigation/status"] is None


def test_a_hole_in_the_recording_is_told_first(run_folder: Path, tmp_path: Path) -> None:
    folder = tmp_path / "hole"
    shutil.copytree(run_folder, folder)
    summary = json.loads((folder / "summary.json").read_text())
    summary["messages"]["/scan"]["received"] += 7
    (folder / "summary.json").write_text(json.dumps(summary))
    for name in (folder, folder / "run.mcap"):
        done = mazebot("replay", str(name), "--service", "localization", "--json")
        lines = done.stderr.splitlines()
        assert len(lines) == 1
        assert lines[0].startswith("warning: ")
        assert lines[0].count(" messages recorded: ") == 1
        assert json.loads(done.stdout)["gap"] in lines[0]


def test_services_are_known_by_their_parameters_where_sources_are_random(
    run_folder: Path, tmp_path: Path
) -> None:
    def change(message: Any) -> Any:
        source = message.envelope.source.encode().hex().ljust(32, "0")[:32]
        return message._replace(envelope=message.envelope._replace(source=source))

    folder = rewritten(run_folder, tmp_path / "bus", change)
    assert replayed(folder, "localization")["same"]
    assert replayed(folder, "navigation")["same"]


@pytest.mark.parametrize("lacks_messages", [True, False])
def test_what_has_been_cut_off_is_replayed_to_its_end_and_is_no_success(
    run_folder: Path, tmp_path: Path, lacks_messages: bool
) -> None:
    folder = rewritten(run_folder, tmp_path / "cut", lambda message: message)
    shutil.copy(run_folder / "summary.json", folder)
    file = folder / "run.mcap"
    data = file.read_bytes()
    assert len(scan(file).chunks) == 2
    file.write_bytes(data[: scan(file).chunks[-1].offset if lacks_messages else -10])
    done = mazebot("replay", str(folder), "--service", "navigation", "--json")
    assert done.stderr.startswith("warning: cut: run.mcap is cut")
    assert (" recorded messages are there" in done.stderr) == lacks_messages
    assert (done.returncode, done.stderr.count("\n")) == (1, 1)
    told = json.loads(done.stdout)
    assert told["end_s"] > 0.0
    assert told["faults"][0] == "run.mcap is cut"


def test_a_run_whose_recorder_was_killed_is_said_to_lack_its_end(
    run_folder: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "killed"
    shutil.copytree(run_folder, folder)
    (folder / "summary.json").unlink()
    (folder / LOCK).touch()
    for name in (folder, folder / "run.mcap"):
        done = mazebot("replay", str(name), "--service", "navigation", "--json")
        assert done.returncode == 0
        assert done.stderr.count("\n") == 1
        assert " was killed while it was recorded: `mazebot recordings repair` " in done.stderr


def test_a_run_that_is_cut_before_its_first_message_is_refused_as_cut(
    run_folder: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "stump"
    shutil.copytree(run_folder, folder)
    file = folder / "run.mcap"
    file.write_bytes(file.read_bytes()[: scan(file).chunks[0].offset + 50])
    done = mazebot("replay", str(folder), "--service", "navigation")
    assert done.returncode != 0
    assert done.stderr == f"error: replay: {file}: is cut before the first message\n"


def test_jpeg_pictures_are_unpacked_and_said_to_have_a_loss(
    run_folder: Path, tmp_path: Path
) -> None:
    grey = np.full((8, 8, 3), 90, np.uint8)
    jpeg = cv2.imencode(".jpg", grey)[1].reshape(-1)

    def change(message: Any) -> Any:
        if message.topic != "/scan":
            return message
        header = wire.decode(BY_NAME["/scan"], message.data).header  # type: ignore[attr-defined]
        picture = msg.CompressedImage(header=header, format="rgb8; jpeg compressed bgr8", data=jpeg)
        return message._replace(
            topic=CAMERA_COMPRESSED.name,
            type_name=wire.type_name(CAMERA_COMPRESSED),
            data=wire.encode(CAMERA_COMPRESSED, picture),
            made_from=CAMERA_IMAGE.name,
        )

    folder = rewritten(run_folder, tmp_path / "jpeg", change)
    done = mazebot("replay", str(folder), "--service", "perception")
    assert (
        "recorded with compressed images (jpeg); perception can only be compared exactly"
        in done.stdout
    )
    assert "is still waiting for the camera's intrinsics" in done.stdout
    told = mazebot("replay", str(run_folder), "--service", "perception").stdout
    assert "recorded without images" in told


@pytest.mark.slow
def test_a_tour_and_an_exploration_are_repeated_exactly_by_each_service(tmp_path: Path) -> None:
    tour = runs.make(tmp_path / "tour", goal=None)
    for service in ("navigation", "localization", "spawner", "bringup", "physics"):
        assert replayed(tour, service)["same"], service
    commands = {row["topic"]: row["same"] for row in replayed(tour, "navigation")["topics"]}
    summary = json.loads((tour / "summary.json").read_text())
    assert commands["/cmd_vel"] == summary["messages"]["/cmd_vel"]["recorded"] > 1000
    room = {"world_name": "room", "worlds_dir": worlds.make(tmp_path / "worlds")}
    slam = runs.make(tmp_path / "slam", goal=None, slam=True, **room)
    for service in ("mapping", "explorer", "navigation"):
        assert replayed(slam, service)["same"], service


@pytest.mark.slow
def test_perception_sees_the_same_in_raw_pictures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MAZEBOT_RECORDER_PICTURES", "raw")
    folder = runs.make(tmp_path / "raw", goal=(1.0, 0.0, 1.5), camera=True, renderer="cpu")
    for service in ("perception", "physics"):
        told = replayed(folder, service)
        assert told["same"]
        assert told["pictures"] == "raw"
