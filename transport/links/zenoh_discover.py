"""Who is there on a zenoh link, as liveliness tokens and the rig's own answer say."""

from __future__ import annotations

import json
from typing import Any, Final

from transport.links.link import TransportError, split_uri
from transport.links.zenoh_link import config, zenoh_directory
from transport.links.zenoh_refusals import require_zenoh

LARGEST_INFO: Final = 1 << 20
"""Bytes of an answer that is read."""


def own_endpoints() -> list[str]:
    """Return the endpoints of the ``zenoh:`` links of this user that are open on this machine."""
    folder = zenoh_directory()
    return [f"unixsock-stream/{path}" for path in sorted(folder.iterdir()) if path.is_socket()] if folder.is_dir() else []


def endpoint_of(uri: str) -> str:
    """Return the endpoint of a rig's link.

    Raises:
        TransportError: no link of zenoh, or one without an endpoint.
    """
    scheme, endpoint, _ = split_uri(uri)
    if scheme != "zenoh" or not endpoint:
        raise TransportError(f"{uri}: expected a link of zenoh, as in zenoh:tcp/127.0.0.1:7447")
    return endpoint


def discover(endpoint: str, wait_s: float) -> list[dict[str, Any]]:
    """Return who is there at an endpoint: name, endpoint, who is alive, and what the rig answers (None if nothing).

    Args:
        endpoint: of a rig.
        wait_s: how long to wait for answers, s.

    Raises:
        TransportError: zenoh is not installed.
    """
    require_zenoh(f"zenoh:{endpoint}")
    import zenoh

    entries = {"mode": "client", "connect/timeout_ms": 0, "connect/exit_on_failure": True}
    try:
        session = zenoh.open(config("controller", endpoint, entries))
    except zenoh.ZError:
        return []
    try:
        alive: dict[str, set[str]] = {}
        for reply in session.liveliness().get("hil/*/*/**", timeout=wait_s):
            if reply.ok is not None:
                _, name, role, *_ = str(reply.ok.key_expr).split("/")
                if role != "commander":
                    alive.setdefault(name, set()).add(role)
        infos: dict[str, Any] = {}
        for reply in session.get("hil/*/info", timeout=wait_s):
            if reply.ok is not None:
                name, info = str(reply.ok.key_expr).split("/")[1], _json_object(reply.ok.payload.to_bytes())
                if info is not None:
                    infos[name] = info
    finally:
        session.close()  # type: ignore[no-untyped-call]
    return [
        {"name": name, "endpoint": endpoint, "alive": sorted(alive.get(name, ())), "info": infos.get(name)}
        for name in sorted(alive.keys() | infos.keys())
    ]


def _json_object(data: bytes) -> dict[str, Any] | None:
    """Return what a rig has announced; None for anything else: whoever answers may be anybody."""
    kinds = {"experiment": str, "period_ns": int, "session": str}
    if len(data) > LARGEST_INFO:
        return None
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) and all(isinstance(found.get(key), kind) for key, kind in kinds.items()) else None
