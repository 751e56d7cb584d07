"""What CONTRIBUTING.md says of the code is true."""

import re
import subprocess

from mazebot.common.files.root import ROOT
from mazebot.common.messages.topics import CAMERA_IMAGE
from tests.conventions.test_conventions import SOURCES

PAGE = (ROOT / "CONTRIBUTING.md").read_text()
NUMBERS = ("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten")
MAX_FILES = 15


def test_the_walk_of_one_camera_image_is_there_file_by_file() -> None:
    walk = re.findall(r"^(\d)\. `([\w/]+\.py)`", PAGE.partition("## The rules")[0], re.MULTILINE)
    assert [int(number) for number, _ in walk] == list(range(1, len(walk) + 1))
    assert f"{NUMBERS[len(walk)]} files" in PAGE
    texts = {path: (ROOT / "services" / "mazebot" / path).read_text() for _, path in walk}
    before = ""
    for path, text in texts.items():
        module = f"mazebot.{path.removesuffix('.py').replace('/', '.')}"
        on_the_way = re.search(r"\b(CAMERA_IMAGE|DETECTIONS)\b", text) or any(
            f"from {module} import" in one for one in texts.values()
        )
        assert on_the_way, f"{path}: neither names the topics nor is imported by a file of the walk"
        assert path != before
        before = path


def test_grep_lists_the_nodes_that_use_a_topic() -> None:
    command = re.search(r"`(grep -rl CAMERA_IMAGE services --include=node.py)` lists the two", PAGE)
    assert command is not None
    listed = subprocess.check_output(command[1].split(), cwd=ROOT, text=True).split()
    users = (*CAMERA_IMAGE.owners, *(name for name in CAMERA_IMAGE.readers if name != "recorder"))
    assert sorted(listed) == sorted(f"services/mazebot/{name}/node.py" for name in users)


def test_every_file_and_folder_that_the_page_names_exists() -> None:
    for path in re.findall(r"`((?:services|tests|worlds|docs)/[\w./]+)`", PAGE):
        assert (ROOT / path).exists(), path


def test_a_folder_holds_a_dozen_files() -> None:
    folders = {path.parent for path in SOURCES}
    for folder in folders:
        files = [path for path in folder.iterdir() if path.is_file() and path.name != "__init__.py"]
        assert len(files) <= MAX_FILES, f"{folder}: {len(files)} files: group them by subject"
