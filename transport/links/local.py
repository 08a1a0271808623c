"""The scheme ``local:``: the controller runs in the rig's own process, so that there is nothing to open."""

from __future__ import annotations

from typing import Never

from transport.links.link import Role, TransportError

LOCAL = "local:"


def open_local(uri: str, role: Role) -> Never:
    """The controller runs in the rig's process (`hil run --link local:`); no end is left to open by a URI.

    Raises:
        TransportError: always; it says what to use instead.
    """
    raise TransportError(
        f"link {uri!r}: the controller runs in the rig's own process, and no {role} can be opened by name; "
        "use can:hil:rig0 between processes"
    )
