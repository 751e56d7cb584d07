"""What a service says at its start of the parameters of a file that count otherwise here."""

from __future__ import annotations

import logging
import shlex
from collections.abc import Sequence

from mazebot.common.nav2_params.report import Report, Row

_NODE_OF_ITS_OWN = "localization"
"""The service of AMCL; that of all other nodes is navigation."""
_MOST_NAMES = 5


def summary(found: Report, service: str) -> tuple[int, str] | None:
    """The level and the text of one line about a service's part of a file; None: every parameter
    counts as it stands, or there is none.

    It is a warning where another value than the file's counts, or a name is not one of Nav2's.
    Parameters that change nothing here are only counted.
    """
    rows = [row for row in found.rows if _service(row) == service]
    other = [row for row in rows if row.differs]
    unknown = [row for row in rows if row.status == "unknown"]
    idle = sum(row.status == "unsupported" and not row.differs for row in rows)
    parts = [
        f", {len(other)} with another value here ({_names(other)})" if other else "",
        f", {len(unknown)} unknown to Nav2 as well ({_names(unknown)})" if unknown else "",
        f", {idle} without effect" if idle else "",
    ]
    if not any(parts):
        return None
    level = logging.WARNING if other or unknown else logging.INFO
    return level, (
        f"{found.name}: {len(rows)} parameters for {service}{''.join(parts)}: "
        f"see `mazebot params {shlex.quote(found.name)}`"
    )


def _service(row: Row) -> str:
    if row.section == _NODE_OF_ITS_OWN:
        return row.section
    return "navigation"


def _names(rows: Sequence[Row]) -> str:
    names = list(dict.fromkeys(f"{row.node}.{row.parameter}" for row in rows))
    more = len(names) - _MOST_NAMES
    return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")
