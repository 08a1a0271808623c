"""What observers find over zenoh: who is there on a link, and the named signals of a running session, as they are logged.

Liveliness tokens and the rig's own answer say who is there (`discover`).
``hil/<name>/signals/plant/measurement`` has the records of the topic ``/plant/measurement``, each a ROS 2 message in CDR
(encoding ``application/cdr;<schema>``, attachment ``t_ns=<session time>``). Queries for ``hil/<name>/signals/schemas`` are
answered with the ``ros2msg`` text of every topic, as JSON. It only publishes: nothing that a peer sends here is read.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final

from transport.links import Closing, TransportError, split_uri
from transport.links.private_directory import private_directory
from transport.links.zenoh_link import NAME, answer, config, zenoh_directory
from transport.links.zenoh_refusals import require_zenoh

_LOOPBACK: Final = re.compile(r"tcp/(127\.\d+\.\d+\.\d+|\[::1\]|localhost):\d{1,5}")
LARGEST_INFO: Final = 1 << 20
"""Bytes of an answer that is read."""
_ANY_HOST: Final = re.compile(r"tcp/[^/#?]+:\d{1,5}")


class SignalPublisher(Closing):
    """Publishes records by topic; use it with ``with``.

    Args:
        uri: ``zenoh:`` (a Unix socket of this user) or ``zenoh:tcp/127.0.0.1:7448``, where subscribers connect; options ``name``
            (default rig0) and ``lan`` (1 lets other machines read). No other link may have that endpoint.
        schemas: topic to name and text of its schema.

    Raises:
        TransportError: a bad URI, an endpoint that other machines reach or that is taken, or zenoh is not installed.
    """

    def __init__(self, uri: str, schemas: Mapping[str, tuple[str, str]]) -> None:
        endpoint, name = _endpoint(uri)
        require_zenoh(uri)
        import zenoh

        self._error, self._closed = zenoh.ZError, False
        try:
            self._session = zenoh.open(config("rig", endpoint, {}))
        except zenoh.ZError as error:
            raise TransportError(f"signals {uri!r}: {error}; is another session there?") from error
        base = f"hil/{name}/signals"
        described = json.dumps({topic: {"schema": of, "text": text} for topic, (of, text) in schemas.items()})
        schemas_of = zenoh.handlers.Callback(partial(answer, f"{base}/schemas", described), indirect=False)
        self._session.declare_queryable(f"{base}/schemas", schemas_of)
        self._publishers = {
            topic: self._session.declare_publisher(
                f"{base}{topic}", encoding=f"application/cdr;{of}", congestion_control=zenoh.CongestionControl.DROP
            )
            for topic, (of, _) in schemas.items()
        }

    @property
    def observers(self) -> dict[str, Callable[[int, bytes], None]]:
        """Topic to the function that publishes a record: session time in ns, and its bytes. None of them raises."""
        return {topic: partial(self._put, publisher.put) for topic, publisher in self._publishers.items()}

    def _put(self, put: Callable[..., Any], t_ns: int, payload: bytes) -> None:
        with suppress(self._error):
            put(bytes(payload), attachment=f"t_ns={t_ns}")

    def close(self) -> None:
        """End it; a second call does nothing."""
        if not self._closed:
            self._closed = True
            with suppress(self._error):
                self._session.close()  # type: ignore[no-untyped-call]


def _endpoint(uri: str) -> tuple[str, str]:
    """Return zenoh's endpoint and the name of the keys.

    Raises:
        TransportError: a URI of another form, or an endpoint that other machines reach and no ``lan=1``.
    """
    scheme, endpoint, options = split_uri(uri)
    name, lan = options.pop("name", "rig0"), options.pop("lan", "0")
    if scheme != "zenoh" or (endpoint and not _ANY_HOST.fullmatch(endpoint)):
        raise TransportError(f"signals {uri!r}: expected zenoh: or zenoh:tcp/HOST:PORT, as in zenoh:tcp/127.0.0.1:7448")
    if options or lan not in ("0", "1") or not NAME.fullmatch(name):
        raise TransportError(f"signals {uri!r}: expected no options but name=NAME (letters, digits, '_', '-', '.') and lan=1")
    if endpoint and lan != "1" and not _LOOPBACK.fullmatch(endpoint):
        raise TransportError(f"signals {uri!r}: other machines could read them there; use 127.0.0.1, or append ?lan=1")
    return endpoint or f"unixsock-stream/{private_directory(zenoh_directory())}/{name}-signals", name


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
    """Return what a rig has announced; None for anything else, as any program may answer."""
    kinds = {"experiment": str, "period_ns": int, "session": str}
    if len(data) > LARGEST_INFO:
        return None
    try:
        found = json.loads(data)
    except (ValueError, RecursionError):
        return None
    fits = isinstance(found, dict) and all(isinstance(found.get(key), kind) for key, kind in kinds.items())
    return found if fits and 0 < found["period_ns"] < 1 << 63 else None
