"""How a rig speaks: the version of the wire format, and the nonce that the answer to a slot must echo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import blake2b
from typing import Literal

KEY_BYTES = 16

WireVersion = Literal[1, 2]


def no_nonce(seq: int) -> int:
    """Return 0: wire version 1 has no nonce, and virtual time needs none."""
    return 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wire:
    """Version and nonces of one session.

    Args:
        version: of the wire format.
        nonce: the nonce of a slot, u64.
    """

    version: WireVersion
    nonce: Callable[[int], int]


VERSION_1 = Wire(version=1, nonce=no_nonce)
VIRTUAL = Wire(version=2, nonce=no_nonce)


def session_wire(key: bytes) -> Wire:
    r"""Return wire version 2 with the nonces :math:`n_k = \mathrm{BLAKE2b}_{key}(k)`, which nobody foretells without the key.

    Args:
        key: `KEY_BYTES` bytes that are new in every session.

    >>> wire = session_wire(bytes(16))
    >>> wire.nonce(1) != wire.nonce(2), wire.nonce(1) == session_wire(bytes(16)).nonce(1)
    (True, True)
    """

    def nonce(seq: int) -> int:
        return int.from_bytes(blake2b(seq.to_bytes(4, "little"), key=key, digest_size=8).digest(), "little")

    return Wire(version=2, nonce=nonce)
