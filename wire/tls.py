"""TLS on Zenoh's links: certificates of a process, and rights by the names in the certificates of its clients."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PROTOCOLS = ("tls/", "quic/")
"""Beginnings of endpoints whose links are encrypted."""


@dataclass(frozen=True, slots=True)
class Certificates:
    """Files of one process, PEM. Both ends of a link show a certificate of the same authority.

    Attributes:
        authority: certificate of the authority.
        certificate: of this process.
        key: private key of that certificate.
    """

    authority: Path
    certificate: Path
    key: Path

    def settings(self) -> Mapping[str, object]:
        """Return Zenoh's configuration; https://zenoh.io/docs/manual/tls/ describes its fields."""
        return {
            "transport/link/tls/root_ca_certificate": str(self.authority),
            "transport/link/tls/enable_mtls": True,
            "transport/link/tls/listen_certificate": str(self.certificate),
            "transport/link/tls/listen_private_key": str(self.key),
            "transport/link/tls/connect_certificate": str(self.certificate),
            "transport/link/tls/connect_private_key": str(self.key),
            "transport/link/tls/verify_name_on_connect": True,
            "transport/link/tls/close_link_on_expiration": True,
        }


@dataclass(frozen=True, slots=True)
class Access:
    """Rights at the keys of one server, by the common names of its clients' certificates. Nobody else has any.

    Attributes:
        space: key space of the server, such as `cell/cell-1`.
        readings: keys under it that a reader may query.
        commanders: names that may do everything under `space`.
        readers: names that may subscribe under `space` and query `readings`.
    """

    space: str
    readings: Sequence[str]
    commanders: Sequence[str]
    readers: Sequence[str] = ()

    def settings(self) -> Mapping[str, object]:
        """Return Zenoh's configuration; https://zenoh.io/docs/manual/access-control/ describes its fields."""
        everything = [f"{self.space}/**"]
        rules = [
            _rule("told", ("put", "reply", "declare_queryable", "declare_subscriber"), "egress", everything),
            _rule("follow", ("declare_subscriber",), "ingress", everything),
            _rule("ask", ("query",), "ingress", [f"{self.space}/{key}" for key in self.readings]),
            _rule("command", ("query", "put"), "ingress", everything),
        ]
        roles = {"commander": (self.commanders, ["told", "follow", "command"]),
                 "reader": (self.readers, ["told", "follow", "ask"])}  # fmt: skip
        filled = {role: (list(names), granted) for role, (names, granted) in roles.items() if names}
        return {
            "access_control": {
                "enabled": True,
                "default_permission": "deny",
                "rules": rules,
                "subjects": [{"id": role, "cert_common_names": names} for role, (names, _) in filled.items()],
                "policies": [{"rules": granted, "subjects": [role]} for role, (_, granted) in filled.items()],
            }
        }


def is_encrypted(endpoint: str) -> bool:
    """Return whether the links of an endpoint are encrypted."""
    return endpoint.startswith(PROTOCOLS)


def _rule(name: str, messages: Sequence[str], flow: str, keys: Sequence[str]) -> Mapping[str, Any]:
    return {
        "id": name, "messages": list(messages), "flows": [flow], "permission": "allow", "key_exprs": list(keys)
    }  # fmt: skip
