"""The package cryptography of ``hilrig[keys]``, which keys, certificates and signatures import."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from transport.links.link import TransportError

INSTALL = "pip install 'hilrig[keys]'"


@contextmanager
def cryptography_needed() -> Iterator[None]:
    """Say how to install the package, where what is imported within lacks it.

    Raises:
        TransportError: it is not installed.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != "cryptography":
            raise
        message = f"keys, certificates and signatures need cryptography, which is not installed: {INSTALL}"
        raise TransportError(message) from None
