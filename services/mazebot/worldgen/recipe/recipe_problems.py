"""The problems of a recipe, with file and line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import ValidationError

from mazebot.common.files.yaml_source import Source
from mazebot.common.problems import (
    Location,
    Mistake,
    Problem,
    WorldError,
    field_name,
    shown_value,
    words,
)
from mazebot.worldgen.assets.sound_parts import SoundParts
from mazebot.worldgen.recipe.field_words import must_of
from mazebot.worldgen.recipe.overrides import (
    MAX_OVERRIDES,
    parse_override,
    shown_override,
    with_value,
)
from mazebot.worldgen.recipe.recipe_fields import place_of


class RecipeProblems:
    """Collects the problems of a recipe that consists of several sources and overrides."""

    def __init__(self, sources: Sequence[Source]) -> None:
        """`sources` are the recipe, then the one it extends, and so on."""
        self.found: list[Problem] = []
        self.sound: SoundParts | None = None
        """What is checked in place of the recipe, where some of its parts are invalid."""
        self._sources = tuple(sources)
        self._overrides: list[tuple[Location, Source]] = []

    @property
    def are_fatal(self) -> bool:
        """Whether one of them makes the world unusable."""
        return any(problem.fatal for problem in self.found)

    def merged(self, overrides: Sequence[str]) -> dict[Any, Any]:
        """The sources' content, the first over the others, and the overrides over all."""
        content: dict[Any, Any] = {}
        for source in reversed(self._sources):
            content = _merge(content, source.content)
        # Problems with what the requested file extends are reported for the chain.
        content["extends"] = self._sources[0].content.get("extends")
        if len(overrides) > MAX_OVERRIDES:
            must = f"must be at most {MAX_OVERRIDES}"
            self.found.append(Problem(field="overrides", value=f"{len(overrides)}", must=must))
            return content
        for override in overrides:
            try:
                place, value = parse_override(override, content)
            except WorldError as error:
                self.found += error.problems
                continue
            content = with_value(content, place, value)
            self._overrides.append((place, Source(shown_override(override), {})))
        return content

    def add(self, mistake: Mistake) -> None:
        """Add a problem of the checked recipe, with the file and the line of its location.

        Problems that are only caused by left-out parts are skipped.
        """
        location, other = mistake.location, mistake.other
        if self.sound is not None:
            if self.sound.explains(location, mistake.value):
                return
            location, other = self.sound.before(location), self.sound.before(other)
        must = mistake.must.replace("{other}", field_name(other))
        self._add(location, shown_value(mistake.value), must, mistake.fatal)

    def add_all(self, error: ValidationError) -> list[Location]:
        """Add the problems of single fields; returns their locations."""
        by_field: dict[tuple[Location, str], str] = {}
        found = error.errors(include_url=False)
        for problem in found:
            # Invalid parts are not counted as parts: so a list may seem too short.
            within = [other for other in found if other["loc"][: len(problem["loc"])] ==
                      problem["loc"]] if problem["type"] == "too_short" else ()  # fmt: skip
            if len(within) > 1:
                continue
            location, _ = place_of(problem["loc"])
            must = must_of(problem, place_of(problem["loc"][:-1])[1])
            missing = problem["type"] == "missing"
            by_field.setdefault((location, must), "" if missing else shown_value(problem["input"]))
        for (location, must), value in by_field.items():
            self._add(location, value, must)
        return [location for location, _ in by_field]

    def _add(self, location: Location, value: str, must: str, fatal: bool = True) -> None:
        given = [source for place, source in self._overrides if location[: len(place)] == place]
        if given:
            source = given[-1]
        else:
            source = max(self._sources, key=lambda source: source.depth_of(location))
        self.found.append(
            Problem(
                file=source.file,
                line=source.line_of(location),
                field=field_name(location),
                value=value,
                must=words(must),
                fatal=fatal,
            )
        )


def _merge(base: Mapping[Any, Any], over: Mapping[Any, Any]) -> dict[Any, Any]:
    """Merge mappings key by key; for everything else `over` wins."""
    merged = dict(base)
    for key, value in over.items():
        below = merged.get(key)
        if isinstance(below, dict) and isinstance(value, dict):
            merged[key] = _merge(below, value)
        else:
            merged[key] = value
    return merged
