"""The known settings: a misspelt one is an error that suggests the nearest name."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from difflib import SequenceMatcher

PREFIX = "MAZEBOT_"
ALONE = (
    "MAZEBOT_CONFIG", "MAZEBOT_PARAMS", "MAZEBOT_SEED", "MAZEBOT_RESOURCE_PATH",
    "MAZEBOT_ROUTER_PORT", "MAZEBOT_VIEWER_PORT", "MAZEBOT_VIEWER_DATA_PORT",
    "MAZEBOT_FOXGLOVE_PORT", "MAZEBOT_PROGRESS",
)  # fmt: skip
"""Variables that are not a field of a service. The ports are used by Docker Compose."""
_NEAR = 0.6
_SAME = 0.85
"""So near must a name be that is in another section than the unknown one."""
_MOST_NAMED = 4

Fields = Mapping[str, Collection[str] | None]
"""The dotted names of each section; None: the section exists, but its fields are known elsewhere.
"""


def matching(name: str, known: Iterable[str]) -> list[str]:
    """The settings that a name stands for: the one of this dotted name, or all that end with it.
    A setting of any depth can be given by its last name, if that is unique; sections that have the
    same name do not count.
    """
    lower, names = name.lower(), list(known)
    exact = [one for one in names if one.lower() == lower]
    ending = [one for one in names if one.lower().endswith(f".{lower}")]
    settings = [one for one in ending if not any(each.startswith(f"{one}.") for each in names)]
    return exact or settings or ending


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
        if fields is None:
            continue
        found = matching(field, fields)
        if len(found) > 1:
            return (
                f"{name}: ambiguous: must be {' or '.join(variable(section, one) for one in found)}"
            )
        if not found:
            start = variable(section, "")
            ports = [one.removeprefix(start).lower() for one in ALONE if one.startswith(start)]
            near = [variable(section, one) for one in _nearest(field, [*ports, *fields])]
            hint = f"; did you mean {' or '.join(near)}?" if near else ""
            return f"{name}: {section} has no field {field!r}{hint}"
    return ""


def unknown_setting(
    name: str, known: Collection[str], shown: Callable[[str], str] = str, within: str = ""
) -> str:
    """The end of the message about an unknown setting: where the nearest ones are, by their last
    names, or all that could be there. `shown` says how a dotted name is shown; `within` is the
    beginning of those in the same section, of which a near one is meant rather than any other.
    """
    there = [one for one in known if one.startswith(within) and "." not in one[len(within) :]]
    if within:
        near = _nearest(name, there) or _nearest(name, known, _SAME)
    else:
        near = _nearest(name, known)
    if near:
        return f"; did you mean {' or '.join(map(shown, near))}?"
    return f"; must be one of {', '.join(map(shown, there))}"


def _nearest(name: str, known: Iterable[str], least: float = _NEAR) -> list[str]:
    """The known dotted names that are nearest to a name, most often one."""

    def nearness(one: str) -> float:
        words, there = set(name.split("_")), set(one.replace(".", "_").split("_"))
        last = one.rpartition(".")[2]
        whole = max(SequenceMatcher(None, name, each).ratio() for each in (one, last))
        both = len(words & there)
        ends = last.endswith(f"_{name}") or (name.endswith(f"_{last}") and both > 1)
        return max(whole, 0.99 * ends, 0.9 * both / len(words))

    near = [(nearness(one), one) for one in known]
    best = max(near, default=(0.0, ""))[0]
    return [one for each, one in near if each >= max(best, least)][:_MOST_NAMED]


def unknown_name(name: str, known: Collection[str]) -> str:
    """The end of the message about an unknown name: the nearest known one, or all of them."""
    return _meant(name, known) or f"; must be one of {', '.join(known)}"


def variable(section: str, field: str) -> str:
    """The environment variable of a setting, by its dotted name."""
    return f"{PREFIX}{section}_{field.replace('.', '__')}".upper()


def _parted(name: str, sections: Iterable[str]) -> tuple[str, str]:
    for section in sections:
        start = f"{PREFIX}{section}_".upper()
        if name.startswith(start):
            return section, name.removeprefix(start).lower().replace("__", ".")
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
