"""Who may speak on a link over zenoh: certificates, passwords, and the access-control list that follows from them.

With ``tls/`` both ends show a certificate of one authority, and zenoh's access-control list denies whatever it does not name:
the peer whose certificate is called *controller* may write the control key at the rig and read the sensor key, the one called
*rig* the reverse at the controller. With a file of passwords the rig's list names the user *controller* in the same way; the
controller, which connects, knows its rig by the endpoint alone.

A rule must cover the subscriber's own key expression, so both ends subscribe to exactly what the list names. Whoever
else connects is told what this end listens to and answers, and that it is there: a zenoh program sends only what somebody
listens to, and so what it writes comes to this end and is denied here, where `transport.links.zenoh_refusals` counts it.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from transport.links.certificates import check_certificate
from transport.links.link import Role, TransportError
from transport.links.revoked import refuse_revoked, revoked_names
from transport.links.secret_file import read_secret

OPTIONS: Final = ("keys", "ca", "cert", "key", "rig", "controller", "users")
"""Options of a zenoh URI that say who may speak."""

_PASSED: Final = {"ca": "{keys}/ca.pem", "cert": "{keys}/{name}.pem", "key": "{keys}/{name}.key"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Access:
    """Who this end is, and whom it hears.

    Args:
        role: this end's.
        peer: name that the other end's certificate or login must have.
        tls: `ca`, `cert` and `key`, paths; empty without TLS.
        users: file of ``name:password`` lines, empty without passwords.
        revoked: names whose certificates are let in no more.
    """

    role: Role
    peer: str
    tls: dict[str, str]
    users: str
    revoked: frozenset[str] = frozenset()

    def config(self, name: str) -> dict[str, Any]:
        """Return the entries of zenoh's configuration.

        Args:
            name: second part of the key expressions.

        Raises:
            TransportError: the file of passwords is not to be had, or has no line for the controller.
        """
        entries: dict[str, Any] = {}
        subject: dict[str, Any] = {}
        if self.tls:
            at = "transport/link/tls"
            entries = {f"{at}/root_ca_certificate": self.tls["ca"], f"{at}/enable_mtls": True}
            entries[f"{at}/close_link_on_expiration"] = True
            for side in ("listen", "connect"):
                entries |= {f"{at}/{side}_certificate": self.tls["cert"], f"{at}/{side}_private_key": self.tls["key"]}
            subject = {"cert_common_names": [self.peer]}
        if self.users:
            lines = read_secret(self.users, "the file of passwords").decode(errors="replace").split("\n")
            known = dict(line.strip().split(":", 1) for line in lines if ":" in line)
            own = "controller" if self.role == "rig" else self.role
            login = self.peer if self.role == "rig" else own
            if login not in known:
                raise TransportError(f"{self.users}: no line {login}:PASSWORD")
            if self.role == "rig":
                mine = {"user": "rig", "password": os.urandom(16).hex()}  # for nobody: a rig connects to none
                entries["transport/auth/usrpwd"] = mine | {"dictionary_file": self.users}
                subject |= {"usernames": [self.peer]}
            else:
                entries["transport/auth/usrpwd"] = {"user": login, "password": known[login]}
        if subject:
            entries["access_control"] = _deny_all_but(subject, self.role, name)
        return entries


def _deny_all_but(subject: dict[str, Any], role: Role, name: str) -> dict[str, Any]:
    says, hears = ("sensor", "control") if role == "rig" else ("control", "sensor")
    to, of = ("egress", "ingress") if role == "rig" else ("ingress", "egress")  # of the rig's answers, of questions to it

    def allow(flow: str, message: str, *keys: str) -> dict[str, Any]:
        key_exprs = [f"hil/{name}/{key}" for key in keys]
        return {"id": f"{message} {flow}", "permission": "allow", "flows": [flow], "messages": [message], "key_exprs": key_exprs}

    tokens = {"rig": ("rig", "hears/*/*/*"), "controller": ("controller", "controller/*/*/*")}
    told = [
        allow("egress", "declare_subscriber", hears),
        allow("egress", "declare_queryable", "info"),
        allow("egress", "liveliness_token", *tokens[role]),
    ]
    peers = [
        allow("ingress", "put", hears),
        allow("egress", "put", says),
        allow("ingress", "declare_subscriber", says),
        allow("ingress", "declare_queryable", "info"),
        allow("ingress", "liveliness_token", *tokens["controller" if role == "rig" else "rig"]),
        allow(of, "query", "info"),
        allow(to, "reply", "info"),
    ]
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [*told, *peers],
        "subjects": [{"id": "peer", **subject}, {"id": "anybody"}],
        "policies": [
            {"id": "only", "rules": [rule["id"] for rule in (*told, *peers)], "subjects": ["peer"]},
            {"id": "told", "rules": [rule["id"] for rule in told], "subjects": ["anybody"]},
        ],
    }


def access(uri: str, role: Role, protocol: str, options: dict[str, str]) -> Access:
    """Take the options that say who may speak out of a URI's.

    ``keys=DIR`` stands for ``ca=DIR/ca.pem&cert=DIR/NAME.pem&key=DIR/NAME.key``, as `hil keys new` makes them; NAME is this
    end's, rig or controller unless ``rig=`` or ``controller=`` choose another. ``{role}`` in a path is rig or controller, so that
    one URI serves both ends.

    Args:
        uri: for messages.
        role: this end's.
        protocol: zenoh's, such as tls.
        options: of the URI; those in `OPTIONS` are taken out.

    Raises:
        TransportError: certificates without TLS, TLS without certificates, files that are not to be had, a
            certificate that the other end would refuse, or a name that is revoked.
    """
    said: dict[str, str] = {option: options.pop(option) for option in OPTIONS if option in options}
    if "keys" in said:
        made = {k: v.replace("{name}", said.get(role, role)).replace("{keys}", said["keys"]) for k, v in _PASSED.items()}
        said = made | {k: v for k, v in said.items() if k != "keys"}
    tls = {name: said[name].replace("{role}", role) for name in _PASSED if name in said}
    if protocol == "tls" and len(tls) < len(_PASSED):
        raise TransportError(
            f"link {uri!r}: tls/ needs ca, cert and key, or keys=DIR of `hil keys new DIR`: without them anybody may connect"
        )
    if protocol != "tls" and tls:
        raise TransportError(f"link {uri!r}: {', '.join(sorted(tls))}: certificates need an endpoint tls/host:port")
    peer = said.get("controller", "controller") if role == "rig" else said.get("rig", "rig")
    try:
        for name in ("ca", "cert"):
            if name in tls and not stat.S_ISREG(Path(tls[name]).stat().st_mode):
                raise TransportError(f"link {uri!r}: {name}={tls[name]}: is no regular file")
        if tls:
            read_secret(tls["key"], f"the private key of the {role}")
            check_certificate(tls["ca"], tls["cert"], said.get(role, role))
            refuse_revoked(tls["ca"], peer)
        if "users" in said:
            read_secret(said["users"], "the file of passwords")
    except OSError as error:
        raise TransportError(f"link {uri!r}: {error.filename}: {error.strerror}") from error
    except ValueError as error:  # a name with a zero byte
        raise TransportError(f"link {uri!r}: a file of it: {error}") from error
    except TransportError as error:
        raise error if str(error).startswith("link ") else TransportError(f"link {uri!r}: {error}") from error
    revoked = revoked_names(tls["ca"]) if tls else frozenset[str]()
    absolute = {k: str(Path(v).absolute()) for k, v in tls.items()}
    return Access(role=role, peer=peer, tls=absolute, users=said.get("users", ""), revoked=revoked)
