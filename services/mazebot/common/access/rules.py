"""The router's rules, made of grants, and what they decide."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import zenoh

from mazebot.common.access.grants import Grant, Verb, grants_of
from mazebot.common.messages.keys import Keys

_FLOWS = ("ingress", "egress")


class Decision(NamedTuple):
    """Whether a request is granted, and by which grant; None: by none, so it is not."""

    is_granted: bool
    grant: Grant | None


def decide(grants: Iterable[Grant], verb: Verb, key: str) -> Decision:
    """Whether something may be done with a key, or with all keys of a key expression.

    As Zenoh's router decides (`policy_decision_point` in its authorization.rs): what a denial
    includes is denied, then what a grant includes is granted, and all else is denied.
    Raises ValueError where it is no key expression.
    """
    try:
        wanted = zenoh.KeyExpr(key)
    except zenoh.ZError as error:
        raise ValueError(f"{key!r:.80}: must be a key expression of Zenoh") from error
    matching = [
        grant
        for grant in grants
        if grant.verb is verb and zenoh.KeyExpr(grant.key).includes(wanted)
    ]
    for grant in sorted(matching, key=lambda grant: not grant.denies):
        return Decision(not grant.denies, grant)
    return Decision(False, None)


def access_control(
    role_of: Mapping[str, str], keys: Keys, operator_sees_truth: bool = True
) -> dict[str, Any]:
    """The section `access_control` of a router's settings for some users and their roles. Whoever
    has no role gets nothing.

    Raises ValueError for an unknown role.
    """
    users: dict[str, list[str]] = defaultdict(list)
    for name, role in sorted(role_of.items()):
        users[role].append(name)
    rules: list[dict[str, Any]] = []
    policies = []
    for role in users:
        of_role = _rules(role, grants_of(role, keys, operator_sees_truth))
        rules += of_role
        policies.append({"subjects": [role], "rules": [rule["id"] for rule in of_role]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [{"id": role, "usernames": names} for role, names in users.items()],
        "policies": policies,
    }


def _rules(role: str, grants: Iterable[Grant]) -> list[dict[str, Any]]:
    """One rule for each verb and flow."""
    keys: dict[tuple[Verb, bool], dict[str, None]] = defaultdict(dict)
    for grant in grants:
        keys[grant.verb, grant.denies][grant.key] = None
    return [
        {
            "id": f"{role} {'must not' if denies else 'may'} {verb.text} {flow}",
            "permission": "deny" if denies else "allow",
            "flows": [flow],
            "messages": list(messages),
            "key_exprs": list(expressions),
        }
        for (verb, denies), expressions in keys.items()
        for flow, messages in zip(_FLOWS, verb.value, strict=True)
        # What somebody must not do is kept from coming in: what goes out to them is theirs to see.
        if messages and not (denies and flow == "egress")
    ]
