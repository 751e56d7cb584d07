"""The configuration of `router`."""

from __future__ import annotations

import ipaddress
import re
from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from mazebot.common.config import Names, OptionalPath, ServiceConfig
from mazebot.common.files.key_file import TLS

_LABEL = r"[A-Za-z0-9_](?:[A-Za-z0-9_-]{0,61}[A-Za-z0-9_])?"
# The last part of a name is no number (RFC 1123), as it is in an address with a mistake.
_HOST_NAME = re.compile(rf"(?=.{{1,253}}\Z)(?:{_LABEL}\.)*(?![0-9]+\Z){_LABEL}\Z")


class RouterConfig(ServiceConfig):
    """The router's endpoint, and its timeout."""

    listen: str = Field(
        "tcp/127.0.0.1:7447",
        pattern=r"^\w+/.+:\d+$",
        description="Zenoh endpoint to listen on; with tls/ in place of tcp/ it encrypts, and the "
        "keys of keys_dir, which it then needs, get certificates",
    )
    tls_hosts: Names = Field(
        (),
        description="names and addresses, with commas, by which others reach a router that "
        "encrypts; those of its own machine's loopback go without saying",
    )
    keys_dir: OptionalPath = Field(
        None,
        description="folder of keys, see `mazebot keys`: whoever has none of them is refused, and "
        "each may do what its role needs; keys that are missing are made. None: everyone may "
        "connect and do everything",
    )
    handout_dir: OptionalPath = Field(
        None,
        description="folder in which each service has one of its name, with its key in own.key, as "
        "in containers; needs keys_dir",
    )
    ground_truth_for: Literal["operator", "grader"] = Field(
        "operator",
        description="with keys, who may read the ground truth: operator: everyone; grader: of "
        "people the grader alone",
    )

    silence_s: float = Field(
        6.0,
        ge=1.0,
        le=3600.0,
        description="wall time without a response after which the router exits, to be restarted",
    )

    @field_validator("tls_hosts")
    @classmethod
    def _are_hosts(cls, hosts: tuple[str, ...]) -> tuple[str, ...]:
        for host in hosts:
            if not _is_host(host):
                raise ValueError(f"{host!r:.60}: must be the name or the IP address of a host")
        return hosts

    @model_validator(mode="after")
    def _can_encrypt(self) -> Self:
        if self.listen.startswith(TLS) and self.keys_dir is None:
            raise ValueError(f"listen: {self.listen}: with tls/, keys_dir must be a folder of keys")
        return self


def _is_host(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return _HOST_NAME.match(text) is not None
    return True
