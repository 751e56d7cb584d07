"""Where the keys of what only Mazebot knows begin. It imports nothing, as `health` needs it."""

RMW_ZENOH = "rmw_zenoh"
PLAIN = "plain"


def own_root(wire: str, domain_id: int, prefix: str) -> str:
    """The beginning of all such keys of a stack: those of one domain are apart from another's."""
    return prefix if wire == PLAIN else f"{domain_id}/{prefix}"
