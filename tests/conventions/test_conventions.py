"""The style, as tests: each message says how to mend what it finds."""

import ast
import re
from collections.abc import Callable, Iterator

import pytest
from pydantic import BaseModel

from mazebot.cli.pages.access_page import access_page
from mazebot.cli.pages.api_page import api_page
from mazebot.cli.pages.parameters_page import CONFIGS, parameters_page, unit_and_meaning
from mazebot.cli.pages.recipes_page import recipes_page
from mazebot.cli.pages.recordings_page import recordings_page
from mazebot.cli.pages.run_schemas import SCHEMAS, schema_text
from mazebot.cli.pages.topics_page import topics_page
from mazebot.common.config import section_model
from mazebot.common.files.root import ROOT
from mazebot.common.messages import topics
from mazebot.common.messages.topics import EDGE, SERVICES, TOPICS

CONSTANTS = {name for name, value in vars(topics).items() if value in TOPICS}
PURE_NAMES = {"config.py", "node.py", "__main__.py", "__init__.py"}
SOURCES = sorted((ROOT / "services" / "mazebot").rglob("*.py"))
TESTS = sorted((ROOT / "tests").rglob("*.py"))
CLOCKS = {"time", "datetime"}


def calls(tree: ast.AST, method: str) -> set[str]:
    """Names of the topics given to `<box>.<method>(TOPIC, ...)`."""
    names = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr == method
            and node.args
            and isinstance(node.args[0], ast.Name)
        ):
            names.add(node.args[0].id)
    return names & CONSTANTS


@pytest.mark.parametrize("service", SERVICES)
def test_each_service_folder_has_the_same_inside(service: str) -> None:
    folder = ROOT / "services" / "mazebot" / service
    missing = PURE_NAMES - {path.name for path in folder.iterdir()}
    assert not missing, f"add {missing} to services/mazebot/{service}"
    code = [
        line
        for line in (folder / "__main__.py").read_text().splitlines()
        if line and not line.startswith('"""')
    ]
    told = f"{service}/__main__.py: three imports and main(...) only, collections held off"
    assert len(code) == 6, told
    assert code[1] == "with collections_held_off():", told


def test_nothing_is_named_after_nothing() -> None:
    vague = [p for p in SOURCES if p.stem in {"utils", "helpers", "base", "misc", "common_utils"}]
    assert not vague, f"name these files after what they compute: {vague}"


def test_the_table_of_topics_is_sound() -> None:
    names = [topic.name for topic in TOPICS]
    assert len(names) == len(set(names)), "a topic has one row"
    for topic in TOPICS:
        assert re.fullmatch(r"(/[a-z][a-z0-9_]*)+", topic.name), topic.name
        assert topic.owners, f"{topic.name}: name an owner"
        assert set(topic.owners) <= {*SERVICES, EDGE}, f"{topic.name}: unknown owner"
        assert {*topic.readers, *topic.keepers} <= set(SERVICES), f"{topic.name}: unknown reader"
        assert not topic.keepers or topic.returned, f"{topic.name}: kept for nobody"
        # Of what several write, one may read what the others have written.
        assert len(topic.owners) > 1 or not set(topic.owners) & set(topic.readers), topic.name
        assert topic.rate_hz is None or topic.rate_hz > 0
        assert topic.depth >= 1


@pytest.mark.parametrize("service", SERVICES)
def test_a_node_uses_the_topics_that_the_table_gives_it(service: str) -> None:
    text = "\n".join(p.read_text() for p in (ROOT / "services" / "mazebot" / service).rglob("*.py"))
    used = {name for name in CONSTANTS if re.search(rf"\b{name}\b", text)}
    loop = {"DIAGNOSTICS", "ROSOUT", "PARAMETERS"}
    for name in CONSTANTS:
        topic = getattr(topics, name)
        mine = service in topic.owners or service in topic.readers
        if name in used:
            assert mine, f"{service} uses {name}: add it to the row in topics.py"
        elif mine and service != "recorder":
            assert name in loop, f"{service} never uses {name}: take it out of the row"


@pytest.mark.parametrize("service", SERVICES)
def test_only_the_node_file_puts_and_reads(service: str) -> None:
    for path in (ROOT / "services" / "mazebot" / service).rglob("*.py"):
        if path.name == "node.py":
            continue
        tree = ast.parse(path.read_text())
        found = calls(tree, "put") | calls(tree, "new") | calls(tree, "latest")
        assert not found, f"{path}: move {found} to node.py"


@pytest.mark.parametrize("service", [s for s in SERVICES if s != "recorder"])
def test_no_node_reads_a_clock_or_the_environment(service: str) -> None:
    for path in (ROOT / "services" / "mazebot" / service).rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Import):
                found = {alias.name for alias in node.names} & CLOCKS
                assert not found, f"{path}: time is an argument, not {found}"
            if isinstance(node, ast.ImportFrom):
                assert node.module not in CLOCKS, f"{path}: time is an argument"
            if isinstance(node, ast.Attribute):
                assert node.attr not in {"environ", "getenv"}, f"{path}: use config.py"


def test_no_banners_no_places_of_this_machine() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {mistake}"
        for path in (*SOURCES, *TESTS)
        for mistake in untidy(path.read_text())
    ]
    assert not found, "\n".join(found)


def untidy(text: str) -> Iterator[str]:
    """What is wrong in a file's text."""
    if re.search(r"^\s*#\s*[-=#*]{4,}", text, re.MULTILINE):
        yield "no banners"
    for word in ("/wo" + "rk/", "/ro" + "ot/"):
        if word in text:
            yield f"names a folder of one machine: {word}"


def test_banners_and_places_are_found() -> None:
    assert list(untidy("# a\n  # " + "-" * 4)) == ["no banners"]
    assert len(list(untidy("at = '/wo" + "rk/a', '/ro" + "ot/b'"))) == 2
    assert not list(untidy("# a\nb = '/home/work'\n"))


def test_tests_do_not_sleep() -> None:
    for path in TESTS:
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "sleep" in text else ():
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
                asleep = node.func.attr == "sleep"
                if asleep and isinstance(node.args[0], ast.Constant):
                    length = node.args[0].value
                    short = isinstance(length, float | int) and length <= 0.2
                    assert short, f"{path}: wait for a condition instead"


@pytest.mark.parametrize(
    ("name", "page"),
    [
        ("api.md", api_page),
        ("access.md", access_page),
        ("topics.md", topics_page),
        ("recipes.md", recipes_page),
        ("parameters.md", parameters_page),
        ("recordings.md", recordings_page),
    ],
)
def test_a_generated_page_is_current(name: str, page: Callable[[], str]) -> None:
    text = (ROOT / "docs" / name).read_text()
    assert text == page(), f"docs/{name} is stale: run `make generate`"


@pytest.mark.parametrize("name", SCHEMAS)
def test_a_generated_schema_is_current(name: str) -> None:
    text = (ROOT / "docs" / "schemas" / f"{name}.schema.json").read_text()
    assert text == schema_text(name), f"docs/schemas/{name} is stale: run `make generate`"


@pytest.mark.parametrize("service", SERVICES)
def test_each_parameter_says_what_it_means(service: str) -> None:
    sections: list[tuple[str, type[BaseModel]]] = [("", CONFIGS[service])]
    for prefix, model in sections:
        for name, field in model.model_fields.items():
            inner = section_model(field)
            if inner is not None:
                sections.append((f"{prefix}{name}.", inner))
                continue
            _, meaning = unit_and_meaning(name, field.description or "")
            assert meaning, f"{service}: {prefix}{name} needs a description"


def test_locks_hold_no_address() -> None:
    for path in ROOT.glob("requirements*.lock"):
        assert "://" not in path.read_text(), f"{path}: run `make lock`"
    assert not (ROOT / "uv.lock").exists(), "uv.lock writes down the addresses of an index"
