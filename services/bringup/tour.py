"""Which goals a tour has, in a world."""

from __future__ import annotations

from services.common.documents import Planar, World

HOME = "home"


class NoLocationsError(ValueError):
    """A world that names no place to drive to."""


def tour_goals(world: World, names: tuple[str, ...]) -> list[tuple[str, Planar]]:
    """The goals of a tour by name; without names, every location in the world's order, then home.

    Home is the robot's start, but in a world that has a location of that name.
    Raises ValueError with one line where the world has no location of a name, NoLocationsError
    where no names are given and it has no location at all.
    """
    places: dict[str, Planar] = {location.name: location for location in world.locations}
    if not names and not places:
        raise NoLocationsError(
            f"tour: {world.recipe} has no locations: add `locations:` to it, or give one goal "
            "(--goal x y yaw)"
        )
    places.setdefault(HOME, world.start)
    for name in names:
        if name not in places:
            known = ", ".join(places)
            raise ValueError(f"tour: {name!r} is no location of {world.name}; it has {known}")
    return [
        (name, Planar(x_m=places[name].x_m, y_m=places[name].y_m, yaw_rad=places[name].yaw_rad))
        for name in names or places
    ]
