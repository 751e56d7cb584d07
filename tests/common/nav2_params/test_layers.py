"""Layers of a costmap: the map is always in the global one, and never in the local one."""

from tests.common.nav2_params.files import row_of, told

STATIC = {"plugin": "nav2_costmap_2d::StaticLayer", "map_topic": "/map"}
INFLATION = {"plugin": "nav2_costmap_2d::InflationLayer", "inflation_radius": 0.4}


def test_the_map_is_in_the_global_costmap_listed_or_not() -> None:
    without = {"plugins": ["inflation_layer"], "inflation_layer": INFLATION}
    note = row_of(told("global_costmap", without), "plugins").note
    assert "lists no StaticLayer: there is always one here" in note
    found = told("global_costmap", {"plugins": ["s", "inflation_layer"], "s": STATIC,
                                    "inflation_layer": INFLATION})  # fmt: skip
    assert "StaticLayer" not in row_of(found, "plugins").note
    row = row_of(found, "s.plugin")
    assert (row.status, row.note) == ("used", "there is always one here")


def test_the_map_is_not_in_the_local_costmap_listed_or_not() -> None:
    without = {"plugins": ["inflation_layer"], "inflation_layer": INFLATION}
    assert "StaticLayer" not in row_of(told("local_costmap", without), "plugins").note
    found = told("local_costmap", {"plugins": ["s", "inflation_layer"], "s": STATIC,
                                   "inflation_layer": INFLATION})  # fmt: skip
    for name in ("s.plugin", "s.map_topic"):
        row = row_of(found, name)
        assert row.status == "unsupported"
        assert row.note == "the local costmap is without the map here"
    assert row_of(found, "s.plugin").differs
