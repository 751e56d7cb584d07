"""Which goals a tour has, in a world."""

from __future__ import annotations

from services.common.documents import Planar, World

HOME = "home"


def tour_goals(world: World, names: tuple[str, ...]) -> list[tuple[str, Planar]]:
    """The goals of a tour by name.

    Raises ValueError with one line where the world has no location of a name.
    """
    places: dict[str, Planar] = {location.name: location for location in world.locations}
    places[HOME] = world.start
    for name in names:
        if name not in places:
            known = ", ".join(places)
            raise ValueError(f"tour: {name!r} is no location of {world.name}; it has {known}")
    return [
        (name, Planar(x_m=places[name].x_m, y_m=places[name].y_m, yaw_rad=places[name].yaw_rad))
        for name in names
    ]
