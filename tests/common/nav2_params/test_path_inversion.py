"""A path is always followed to where it turns back first: what asks for that is used."""

from typing import Any

import pytest

from tests.common.nav2_params.files import row_of, told


@pytest.mark.parametrize(
    ("place", "status"),
    [
        (
            {"path_handler_plugins": ["mine"], "mine": "nav2_controller::FeasiblePathHandler"},
            "used",
        ),
        (
            {"controller_plugins": ["mine"], "mine": "nav2_mppi_controller::MPPIController"},
            "mapped",
        ),
    ],
)
def test_what_asks_for_path_inversion_is_used(place: dict[str, Any], status: str) -> None:
    def statuses(**values: Any) -> dict[str, str]:
        plugin = {"plugin": place["mine"], **values}
        found = told("controller_server", {**place, "mine": plugin})
        rows = {name: row_of(found, f"mine.{name}") for name in values}
        return {name: row.status for name, row in rows.items()}

    there = statuses(enforce_path_inversion=True, inversion_xy_tolerance=0.2)
    assert there == dict.fromkeys(there, status)
    away = statuses(enforce_path_inversion=False, inversion_xy_tolerance=0.4)
    assert away == dict.fromkeys(away, "unsupported")
