"""Prints docs/access.md from the rules that are made of the tables of topics and services."""

from __future__ import annotations

import sys

from mazebot.common.access.grants import PEOPLE, Verb
from mazebot.common.access.matrix import Row, in_short, matrix
from mazebot.common.messages.keys import Keys

_HEAD = """# Access to the bus

Generated from `services/mazebot/common/access/` by `make generate`; do not edit.

With keys, the router lets nobody in without one, and each does only what its role needs. Containers
have them from the first start on. Without, whoever can open the router's port can drive the robot
and forge its sensors; the port is open on this machine alone.

## In containers

The keys are in `keys/` of the clone, and belong to its owner. `mazebot`, `make goal` and programs
that use Mazebot find the operator's by themselves, if they are started in the clone; elsewhere
`MAZEBOT_BUS_KEY_FILE` names it. Each container sees its own key alone, in a volume that it shares
with the router; the console and Foxglove command as the operator.

```
docker compose -f docker-compose.yaml -f docker/open.yaml up simulator-enhanced   # without keys
docker compose -f docker-compose.yaml -f docker/tls.yaml up demo-world-enhanced   # encrypted
GROUND_TRUTH_FOR=grader docker compose up demo-world-enhanced                     # an exam
```

Without keys every node of ROS 2 on this machine joins, and what only your own nodes have passes the
router, too: Nav2 in place of our navigation needs that. In an exam, of people only a grader may
read the ground truth.

## Without Docker

For a class, an exam, or a machine with several users:

```sh
mazebot up --world original --keys keys     # makes the keys that are missing in the folder `keys`
mazebot ps                                  # your own tools find the operator's key by themselves
mazebot down
mazebot keys make
mazebot keys list
mazebot keys add anna --role viewer         # a file to hand over: keys/anna.key
mazebot security explain anna /cmd_vel      # which rule decides
mazebot security matrix                     # the table below
mazebot keys rotate                         # new keys for everyone; the old ones are refused
mazebot keys revoke anna
```

Anna sets `MAZEBOT_BUS_KEY_FILE=anna.key` and uses the same commands; what her key does not let her
do is refused in a line. While a stack runs, keys may be made, revoked and replaced: within a second
everyone signs in again, the robot stands for that time, and the services go on where they were. A
key that is wrong changes nothing, and the router's log names it. A revoked key ends what its owner
watches, with a line that says so, but not what the robot was told: a goal goes on to its end, and
its result is recorded. Whoever may command the robot ends it by `mazebot cancel`, or holds the
robot by `mazebot stop`.

A service publishes the topics that the table gives it, and no others; nobody has its name but
itself. A node of ROS 2 signs in by `ZENOH_CONFIG_OVERRIDE`, which `mazebot doctor --ros` prints
with the operator's key. It must be a client (`mode="client"`): two peers talk past the router, and
past its rules. With a wildcard, such as `**`, nothing is read. A program that localises, maps or
drives in place of ours signs in as `autonomy`, a robot or simulator in place of `physics` as
`robot`.

The console signs in with one key for all who open its page ([console](console.md)). In lockstep,
keys must not be changed while a run goes on. `MAZEBOT_ROUTER_GROUND_TRUTH_FOR=grader` makes the
exam without Docker.

## Encrypted

Without TLS, passwords and messages cross the network in the open: keys alone are for one machine,
or a network that you trust. With `docker/tls.yaml`, or as
`python -m mazebot.router --listen tls/0.0.0.0:7447 --keys-dir keys`, the router speaks TLS 1.3
only. It makes an authority of its own in the folder (`authority.pem`: leave it there, it signs the
certificates), and puts a certificate into each key, which both sides show each other. They last for
398 days; the router makes new ones when it starts within 30 days of their end. Tools connect to
`tls/`:

```
MAZEBOT_BUS_CONNECT=tls/127.0.0.1:7447 mazebot goal 0.5 -0.9 0
```

From another machine, hand over `keys/operator.key` by a safe way, publish the router's port there,
and start it with `TLS_HOSTS=NAME` (without Docker `--tls-hosts NAME`), the name or address by which
it is reached: a router whose certificate has another one is not trusted.

## Roles

| role | may |
| --- | --- |
"""
_SERVICE_ROLE = "| each service | publishes, reads and answers what the tables below say |\n"
_TOPICS_HEAD = """
## Topics

| topic | may publish | may read |
| --- | --- | --- |
"""
_SERVICES_HEAD = """
## Queries, services and actions

| name | may ask | may answer |
| --- | --- | --- |
"""


def access_page() -> str:
    """Return the text of the page."""
    roles = "".join(f"| {role} | {about} |\n" for role, about in PEOPLE.items())
    rows = list(matrix(Keys()))
    topics = [row for row in rows if Verb.PUT in row.roles]
    services = [row for row in rows if Verb.PUT not in row.roles]
    return (
        _HEAD + roles + _SERVICE_ROLE + _TOPICS_HEAD + _table(topics) + _SERVICES_HEAD
        + _table(services)
    )  # fmt: skip


def _table(rows: list[Row]) -> str:
    return "".join(
        f"| `{row.name}` | {' | '.join(in_short(roles) for roles in row.roles.values())} |\n"
        for row in rows
    )


if __name__ == "__main__":
    sys.stdout.write(access_page())
