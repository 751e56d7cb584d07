import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from pydantic import Field

from mazebot.common.config import ConfigError, ServiceConfig, printable
from mazebot.common.files.root import ROOT
from mazebot.common.settings.known_settings import ALONE
from mazebot.common.settings.load import load


class PhysicsConfig(ServiceConfig):
    rate_hz: float = Field(10.0, gt=0)
    renderer: str = "auto"


def test_flags_win_over_environment_over_file_over_defaults(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "mazebot.yaml"
    file.write_text("physics: {rate_hz: 2, renderer: tiny}\n")
    assert load(PhysicsConfig, "physics", []).rate_hz == 10.0
    assert load(PhysicsConfig, "physics", ["--config", str(file)]).rate_hz == 2.0
    monkeypatch.setenv("MAZEBOT_CONFIG", str(file))
    monkeypatch.setenv("MAZEBOT_PHYSICS_RATE_HZ", "3")
    config = load(PhysicsConfig, "physics", [])
    assert (config.rate_hz, config.renderer) == (3.0, "tiny")
    assert load(PhysicsConfig, "physics", ["--rate-hz", "4"]).rate_hz == 4.0


def test_one_seed_reaches_every_service(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_SEED", "11")
    assert load(PhysicsConfig, "physics", []).seed == 11
    assert load(PhysicsConfig, "physics", ["--seed", "12"]).seed == 12


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--rate-hz", "-3"], ["physics", "rate_hz", "greater than 0", "-3"]),
        (["--rate-hz", "nan"], ["rate_hz", "finite", "nan"]),
        (["--rate-hz", "fast"], ["rate_hz", "number", "fast"]),
        (["--seed", "-1"], ["seed", "-1"]),
        (["--nope", "3"], ["--nope"]),
        (["--config", "/does/not/exist.yaml"], ["/does/not/exist.yaml", "No such file"]),
        (["--config"], ["--config"]),
    ],
)
def test_a_mistake_is_one_line(arguments: list[str], words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        load(PhysicsConfig, "physics", arguments)
    assert "\n" not in str(caught.value)
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "text", ["physics: [1, 2]", "physics: {nope: 1}", ": :", "\t", "[]", "\xff"]
)
def test_a_broken_file_is_one_line(tmp_path: Path, text: str) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(ConfigError) as caught:
        load(PhysicsConfig, "physics", ["--config", str(file)])
    assert "\n" not in str(caught.value)


def test_what_is_given_wins_over_all_and_is_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MAZEBOT_PHYSICS_RATE_HZ", "3")
    monkeypatch.setenv("MAZEBOT_PHYSICS_RENDERER", "tiny")
    config = load(PhysicsConfig, "physics", (), {"rate_hz": 5.0})
    assert (config.rate_hz, config.renderer) == (5.0, "tiny")
    with pytest.raises(ConfigError, match=r"^physics: rate_hz: .*greater than 0.*-1"):
        load(PhysicsConfig, "physics", (), {"rate_hz": -1})


def test_without_flags_or_variables_what_reads_them_is_not_loaded() -> None:
    code = (
        "import sys\n"
        "from mazebot.bringup.config import BringupConfig\n"
        "from mazebot.common.settings.load import load\n"
        "load(BringupConfig, 'bringup', (), {'goal': (1.0, 0.0, 0.0)})\n"
        "sys.exit('pydantic_settings' in sys.modules)"
    )
    environment = {n: v for n, v in os.environ.items() if not n.startswith("MAZEBOT_")}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=60)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("MAZEBOT_PHYSICS_RENDRER", ["no field 'rendrer'", "MAZEBOT_PHYSICS_RENDERER?"]),
        ("MAZEBOT_PHYSCIS_RENDERER", ["unknown variable", "MAZEBOT_PHYSICS_RENDERER?"]),
        ("MAZEBOT_RENDERER", ["unknown variable", "MAZEBOT_PHYSICS_RENDERER?"]),
        ("MAZEBOT_SEEED", ["unknown variable", "MAZEBOT_SEED?"]),
        ("MAZEBOT_VIEWER_PROT", ["unknown variable", "MAZEBOT_VIEWER_PORT?"]),
        ("mazebot_physics_rate", ["no field 'rate'", "MAZEBOT_PHYSICS_RATE_HZ?"]),
    ],
)
def test_a_misspelt_variable_is_told_with_the_nearest(
    monkeypatch: pytest.MonkeyPatch, name: str, words: list[str]
) -> None:
    monkeypatch.setenv(name, "3")
    with pytest.raises(ConfigError) as caught:
        load(PhysicsConfig, "physics", [])
    for word in (name, *words):
        assert word in str(caught.value)


def test_what_others_read_is_no_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    compose = (ROOT / "docker-compose.yaml").read_text()
    names = {*re.findall(r"MAZEBOT_[A-Z0-9_]+", compose), *ALONE, "MAZEBOT_NAVIGATION_SPIN_DIST"}
    assert "MAZEBOT_VIEWER_DATA_PORT" in names
    for name in names:
        monkeypatch.setenv(name, "8")
    for file in ("MAZEBOT_CONFIG", "MAZEBOT_PARAMS"):
        monkeypatch.delenv(file)
    assert load(PhysicsConfig, "physics", []).seed == 8


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("physcis: {rate_hz: 2}", ["physcis", "unknown section", "physics?"]),
        (
            "physics: {rate_hz: 2}\nfoo: {}",
            ["foo", "must be one of seed, bus, console, ros2_bridge, router"],
        ),
        ("physics: {rate: 2}", ["physics.rate: 2", "unknown field", "rate_hz?"]),
        ("physics: 3", ["physics: 3", "mapping of fields"]),
        ("physics: {rate_hz: -2}", ["rate_hz", "greater than 0", "-2 from", "bad.yaml"]),
        ("seed: -3", ["seed", "-3 from", "bad.yaml"]),
        ("seed:", ["seed", "None from", "bad.yaml"]),
        ("physics: {rate_hz: }", ["rate_hz", "None from", "bad.yaml"]),
        ("services: {physics: {rate: 2}}", ["physics.rate: 2", "rate_hz?"]),
        ("services: {}\nworld: x\nphysics: {}", ["physics", "unknown section"]),
        ("physics: {rate_hz: 2", [":2: not YAML", "not closed"]),
        ("a:\n\tb: 1", [":2: not YAML: column 1: a tab"]),
    ],
)
def test_a_mistake_in_a_file_names_file_field_and_the_nearest(
    tmp_path: Path, text: str, words: list[str]
) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load(PhysicsConfig, "physics", ["--config", str(file)])
    for word in (str(file), *words):
        assert word in str(caught.value)


def test_where_a_wrong_value_is_from_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigError, match="got '-3' from --rate-hz"):
        load(PhysicsConfig, "physics", ["--rate-hz", "-3"])
    monkeypatch.setenv("MAZEBOT_PHYSICS_RATE_HZ", "-4")
    with pytest.raises(ConfigError, match="got '-4' from MAZEBOT_PHYSICS_RATE_HZ"):
        load(PhysicsConfig, "physics", [])


def test_a_file_of_settings_has_one_seed_for_all(tmp_path: Path) -> None:
    file = tmp_path / "mazebot.yaml"
    file.write_text("seed: 9\nphysics: {rate_hz: 2}\n")
    assert load(PhysicsConfig, "physics", ["--config", str(file)]).seed == 9
    file.write_text("seed: 9\nphysics: {rate_hz: 2, seed: 4}\n")
    assert load(PhysicsConfig, "physics", ["--config", str(file)]).seed == 4


def test_the_help_names_the_program(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        load(PhysicsConfig, "physics", ["--help"])
    assert capsys.readouterr().out.startswith("usage: python -m mazebot.physics ")


@pytest.mark.parametrize(("name", "shown"), [
    (b"w\xc3\xb6rld".decode("ascii", "surrogateescape"), "w\u00f6rld"),
    (os.fsdecode(b"w\xf6rld"), r"w\xf6rld"),
    ("a\nb\ud800", r"a\x0ab\xd800"),
])  # fmt: skip
def test_a_name_that_the_locale_cannot_read_is_shown_by_its_bytes(name: str, shown: str) -> None:
    assert printable(name) == shown
