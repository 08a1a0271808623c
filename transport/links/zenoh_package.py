"""The package of ``hilrig[zenoh]``, which only a link over zenoh imports."""

from __future__ import annotations

from importlib import import_module

from transport.links.link import TransportError

INSTALL = "pip install 'hilrig[zenoh]'"


def require_zenoh(uri: str) -> None:
    """Refuse a link over zenoh where zenoh is not installed.

    Raises:
        TransportError: with the command that installs it.
    """
    try:
        import_module("zenoh")
    except ModuleNotFoundError as error:
        if error.name != "zenoh":
            raise
        raise TransportError(f"link {uri!r}: zenoh is not installed: {INSTALL}") from None
