"""Which runs a page shows, and in which order, by its address."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from urllib.parse import urlencode

from starlette.datastructures import QueryParams

from mazebot.common.recordings.catalog import RecordingInfo

PAGE_SIZE = 36
_MOST_CHARACTERS = 200

Key = Callable[[RecordingInfo], float | str | None]

SORTS: dict[str, tuple[str, Key | None, bool]] = {
    "newest": ("newest first", None, False),
    "oldest": ("oldest first", None, True),
    "name": ("name", lambda card: card.name, False),
    "longest": ("longest simulated", lambda card: card.sim_time_s, True),
    "distance": ("longest distance", lambda card: card.distance_m, True),
    "error": ("largest error", lambda card: card.error_mean_m, True),
    "accurate": ("smallest error", lambda card: card.error_mean_m, False),
    "contacts": ("most contacts", lambda card: card.contacts, True),
    "fastest": ("fastest simulated", lambda card: card.real_time_factor, True),
    "size": ("largest files", lambda card: card.size_bytes, True),
}
"""By the value in the address: its label, the figure, and whether large comes first. A
run without the figure comes last.
"""
RESULTS = {"reached": "all reached", "failed": "not all reached", "none": "no goal"}
STATES = {"running": "running", "ended": "ended", "interrupted": "interrupted"}


@dataclass(frozen=True)
class RunQuery:
    """Filter, order and page."""

    text: str = ""
    world: str = ""
    result: str = ""
    state: str = ""
    tag: str = ""
    sort: str = "newest"
    page: int = 1

    @classmethod
    def of(cls, params: QueryParams) -> RunQuery:
        """From an address; unknown values are left out."""

        def given(name: str) -> str:
            return params.get(name, "").strip()[:_MOST_CHARACTERS]

        result, state, sort = given("result"), given("state"), given("sort")
        page = given("page")
        return cls(
            text=given("q"),
            world=given("world"),
            result=result if result in RESULTS else "",
            state=state if state in STATES else "",
            tag=given("tag"),
            sort=sort if sort in SORTS else "newest",
            page=max(int(page), 1) if page.isascii() and page.isdigit() and len(page) < 9 else 1,
        )

    def address(self, **changes: object) -> str:
        """The query of an address for this, with some values changed."""
        query = replace(self, **changes)  # type: ignore[arg-type]
        values = {
            "q": query.text,
            "world": query.world,
            "result": query.result,
            "state": query.state,
            "tag": query.tag,
            "sort": "" if query.sort == "newest" else query.sort,
            "page": "" if query.page == 1 else str(query.page),
        }
        parameters = urlencode({name: value for name, value in values.items() if value})
        return f"?{parameters}" if parameters else ""

    @property
    def is_filter(self) -> bool:
        """Whether some runs are left out."""
        return bool(self.text or self.world or self.result or self.state or self.tag)


@dataclass(frozen=True)
class Selection:
    """The runs that one page shows."""

    cards: tuple[RecordingInfo, ...]
    matching: int
    total: int
    page: int
    pages: int


Searched = Callable[[RecordingInfo], str]
"""The text of a run in which words are searched, in small letters."""


def select(cards: Sequence[RecordingInfo], query: RunQuery, searched: Searched) -> Selection:
    """The page of a query; a page after the last one is the last one."""
    found = _sorted([card for card in cards if matches(card, query, searched)], query.sort)
    pages = max(-(-len(found) // PAGE_SIZE), 1)
    page = min(query.page, pages)
    shown = found[(page - 1) * PAGE_SIZE : page * PAGE_SIZE]
    return Selection(tuple(shown), len(found), len(cards), page, pages)


def result_of(card: RecordingInfo) -> str:
    """The key in `RESULTS`."""
    if card.exploration:
        return "reached" if card.exploration == "complete" else "failed"
    if card.goals_total == 0:
        return "none"
    return "failed" if card.goals_reached < card.goals_total else "reached"


def matches(card: RecordingInfo, query: RunQuery, searched: Searched) -> bool:
    """Whether a run passes the filter: all words of the text are found in it."""
    if query.world and card.world != query.world:
        return False
    if query.result and result_of(card) != query.result:
        return False
    if query.state and card.state != query.state:
        return False
    if query.tag and query.tag not in card.tags:
        return False
    words = query.text.lower().split()
    if not words:
        return True
    text = searched(card)
    return all(word in text for word in words)


def _sorted(cards: list[RecordingInfo], sort: str) -> list[RecordingInfo]:
    """The runs, which are newest first, in an order of `SORTS`."""
    _, key, is_reversed = SORTS[sort]
    if key is None:
        return cards[::-1] if is_reversed else cards
    pairs = [(key(card), card) for card in cards]
    known = [(value, card) for value, card in pairs if value is not None]
    known.sort(key=lambda pair: pair[0], reverse=is_reversed)
    return [card for _, card in known] + [card for value, card in pairs if value is None]


def options(values: Iterable[str]) -> list[str]:
    """The different values, in order."""
    return sorted({value for value in values if value}, key=str.lower)
