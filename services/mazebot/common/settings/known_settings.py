"""The known settings: a misspelt one is an error that suggests the nearest name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from difflib import SequenceMatcher

PREFIX = "MAZEBOT_"
ALONE = (
    "MAZEBOT_CONFIG", "MAZEBOT_PARAMS", "MAZEBOT_SEED", "MAZEBOT_RESOURCE_PATH",
    "MAZEBOT_ROUTER_PORT", "MAZEBOT_VIEWER_PORT", "MAZEBOT_VIEWER_DATA_PORT",
)  # fmt: skip
"""Variables that are not a field of a service. The ports are used by Docker Compose."""
_NEAR = 0.6

Fields = Mapping[str, Collection[str] | None]
"""The fields of each section; None: the section exists, but its fields are known elsewhere."""


def unknown_variable(names: Iterable[str], fields_of: Fields) -> str:
    """The problem of the first unknown `MAZEBOT_*` variable, in one line; empty: none."""
    for name in names:
        upper = name.upper()
        if not upper.startswith(PREFIX) or upper in ALONE:
            continue
        section, field = _parted(upper, fields_of)
        if not section:
            return f"{name}: unknown variable{_meant(upper, _variables(upper, fields_of))}"
        fields = fields_of[section]
        if fields is not None and field not in fields:
            known = [*ALONE, *(variable(section, one) for one in fields)]
            return f"{name}: {section} has no field {field!r}{_meant(upper, known)}"
    return ""


def unknown_name(name: str, known: Collection[str]) -> str:
    """The end of the message about an unknown name: the nearest known one, or all of them."""
    return _meant(name, known) or f"; must be one of {', '.join(known)}"


def variable(section: str, field: str) -> str:
    """The environment variable of a field."""
    return f"{PREFIX}{section}_{field}".upper()


def _parted(name: str, sections: Iterable[str]) -> tuple[str, str]:
    for section in sections:
        start = f"{PREFIX}{section}_".upper()
        if name.startswith(start):
            return section, name.removeprefix(start).lower()
    return "", ""


def _variables(name: str, fields_of: Fields) -> list[str]:
    """All known variables; of a section with unknown fields, the one with the same field."""
    rest = name.removeprefix(PREFIX).partition("_")[2]
    known = list(ALONE)
    for section, fields in fields_of.items():
        known += [variable(section, one) for one in ((rest,) if fields is None else fields)]
    return known


def _meant(name: str, known: Iterable[str]) -> str:
    """The nearest of the known names, as a suggestion. A name with the same ending is near."""
    tail = name.removeprefix(PREFIX)

    def nearness(one: str) -> float:
        whole = SequenceMatcher(None, name, one).ratio()
        return max(whole, 0.99) if tail and one.endswith(f"_{tail}") else whole

    near = max(known, key=nearness, default=None)
    return f"; did you mean {near}?" if near is not None and nearness(near) >= _NEAR else ""
