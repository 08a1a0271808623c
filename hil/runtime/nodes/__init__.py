r"""What a slot is made of: rig, controller node, safety. Nodes do no I/O and read no clock. Here is the randomness of a session.

And which exceptions of a run are those of a part of its loop (`failure_of`), and what they say.

Each part draws from a random stream of its own name, so that adding a component never shifts another's draws.

A process that knows the past nonces of a session cannot compute the next, and can check that it is genuine.

.. math:: n_k = h(n_{k+1}), \qquad h(n) = \mathrm{SHA256}(n)_{1 \ldots 8},

a hash chain that is computed backwards from a secret and revealed slot by slot; the hello reveals
:math:`n_{-1}`. So only the rig can put a question for a slot that the rig has not begun, without any key at the controller.
After `SEGMENT` slots the next chain begins.

Reference: L. Lamport, Password authentication with insecure communication, Comm. ACM 24 (1981) 770-772; A. Perrig et al., The
TESLA broadcast authentication protocol, RSA CryptoBytes 5 (2002) 2-13.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from hashlib import sha256
from typing import Final

import numpy as np
from msgspec import Struct

from hil.log import PLANT_FAILED, PLUG_IN_FAILED
from hil.plugins.user_plugins import user_failure
from hil.rig.loop import Loop
from plants.errors import PlantError


def rng_for(seed: int, name: str) -> np.random.Generator:
    """Return the generator of one named stream of a run.

    Args:
        seed: the experiment's seed.
        name: name of the stream, such as ``"link.sc"``.

    >>> a, b = rng_for(0, "link.sc"), rng_for(0, "link.ca")
    >>> bool(a.random() == rng_for(0, "link.sc").random()), bool(a.random() == b.random())
    (True, False)
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *_words(name)])))


def begun(name: str, first: int) -> str:
    """Return the name of the stream of what begins in a slot: what takes over in a run repeats no number of what ran before.

    >>> begun("link.ca", 0), begun("link.ca", 40)
    ('link.ca', 'link.ca from slot 40')
    """
    return f"{name} from slot {first}" if first else name


@lru_cache(maxsize=64)
def _words(name: str) -> tuple[int, ...]:
    return tuple(np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype=np.uint32).tolist())


KEY_BYTES: Final = 16
SEGMENT: Final = 1 << 18
"""Slots of one chain: 0.2 s of work before the session, 2 MB."""

_BYTES: Final = 8


def before(nonce: int) -> int:
    """Return the nonce of the slot before that of a nonce.

    >>> hex(before(0))
    '0x7a0b81a1f57055af'
    """
    return int.from_bytes(sha256(nonce.to_bytes(_BYTES, "little")).digest()[:_BYTES], "little")


class Wire(Struct, frozen=True, kw_only=True):
    """The nonces in the frames of a rig.

    Args:
        nonce: the nonce of a slot, u64.
        hello: the nonce of the hello; 0 where there is no hello, as in a replay.
    """

    nonce: Callable[[int], int]
    hello: int = 0


def session_wire(secret: bytes, slots: int = SEGMENT) -> Wire:
    """Return the nonces of a session.

    Args:
        secret: `KEY_BYTES` bytes that are new in every session.
        slots: slots of the session.

    >>> wire = session_wire(bytes(16), 10)
    >>> before(wire.nonce(0)) == wire.hello, before(wire.nonce(9)) == wire.nonce(8)
    (True, True)
    """
    chain = _Chain(secret, min(max(slots, 1), SEGMENT))
    return Wire(nonce=chain.nonce, hello=chain.first)


class _Chain:
    """The chain of the slots at hand, and behind it the next one, which grows by one nonce a slot."""

    def __init__(self, secret: bytes, length: int) -> None:
        self._secret, self._length, self._part = secret, length, 0
        self._made = self._begin(0)
        while self._left:
            self._step()
        self._now, self.first = self._made, before(int.from_bytes(self._made[:_BYTES], "little"))
        self._made = self._begin(1)

    def _begin(self, part: int) -> bytearray:
        self._left = self._length
        self._value = sha256(self._secret + part.to_bytes(4, "little")).digest()[:_BYTES]
        return bytearray(self._length * _BYTES)

    def _step(self) -> None:
        """Put one more nonce in front of the chain that is made."""
        self._left -= 1
        self._value = sha256(self._value).digest()[:_BYTES]
        self._made[self._left * _BYTES : (self._left + 1) * _BYTES] = self._value

    def nonce(self, k: int) -> int:
        """Return the nonce of slot k; slots are asked for in order."""
        part, at = divmod(k, self._length)
        if part != self._part:
            while self._left:
                self._step()
            self._now, self._part = self._made, part
            self._made = self._begin(part + 1)
        elif self._left:
            self._step()
        return int.from_bytes(self._now[at * _BYTES : (at + 1) * _BYTES], "little")


def failure_of(loop: Loop, error: BaseException, *others: object) -> tuple[str, str] | None:
    """Return the kind of the event that an exception is, and what it says; None for one that no part of the loop raised.

    Args:
        loop: what ran.
        error: as it was caught.
        others: what ran beside it and may be a user's own, such as the link.
    """
    if isinstance(error, PlantError):
        return PLANT_FAILED, str(error)
    parts = (loop.experiment.plant, loop.controller, *loop.rig.laws, *others)
    text = None if isinstance(error, KeyboardInterrupt) else user_failure(error, parts)
    return None if text is None else (PLUG_IN_FAILED, text.encode("utf-8", "backslashreplace").decode())


@contextmanager
def failing(loop: Loop, said: Callable[[str, str], object], *others: object) -> Iterator[None]:
    """Say which part of a loop raised within, and what; any other exception goes on.

    Args:
        loop, others: as of `failure_of`.
        said: called with what that returns.
    """
    try:
        yield
    except BaseException as error:
        failure = failure_of(loop, error, *others)
        if failure is None:
            raise
        said(*failure)
