"""The parameter files that Nav2 ships, made of the table in tests/data/nav2_params."""

from typing import Any

import yaml

from mazebot.common.files.root import ROOT

DISTRIBUTIONS = {
    "humble": "H", "iron": "I", "jazzy": "J", "kilted": "K", "lyrical": "L",
}  # fmt: skip
_TABLE = ROOT / "tests" / "data" / "nav2_params" / "shipped.txt"


def shipped(distribution: str) -> str:
    """The text of nav2_params.yaml of a distribution, costmaps doubled as there."""
    letter = DISTRIBUTIONS[distribution]
    nodes: dict[str, Any] = {}
    section = ""
    for line in _TABLE.read_text().splitlines():
        if not line or line.startswith("#"):
            continue
        if line.startswith("["):
            section = line.strip("[]")
            continue
        letters, name, value = line.split(" ", 2)
        if letter not in letters:
            continue
        *path, last = f"{section}.{name}".split(".")
        node = path.pop(0)
        inner = nodes.setdefault(node, {})
        inner = inner.setdefault(node, {}) if node.endswith("_costmap") else inner
        inner = inner.setdefault("ros__parameters", {})
        for part in path:
            inner = inner.setdefault(part, {})
        inner[last] = yaml.safe_load(value)
    return yaml.safe_dump(nodes, sort_keys=False)
