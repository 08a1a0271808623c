r"""How both ends of a link prove who they are: by a code in every packet, or by certificates that the other end accepts.

A link whose packets carry a message authentication code, ``can:hil:rig0?auth=frames.key``, lies over any other link. The idea is
that of AUTOSAR's secure on-board communication (SecOC): a truncated code and a counter in the frame itself,

.. math:: t = \mathrm{CMAC}_{\mathrm{AES}}(K,\; n_0 \,\|\, p)_{1 \ldots 8},

of the nonce :math:`n_0` of the session (that of the hello, 8 bytes, little endian), the packet p from
offset 2 to its last value. p holds kind, slot, the nonce of the question or its echo, and a counter that grows with every
frame of its sender, so that no code is good for another direction, slot or session. 8 bytes: a forger who tries a million
frames a second for a year succeeds once with probability 2e-6.

What has no code, a wrong one, or a counter that has been seen is refused and counted. A controller takes another session only
when it has received nothing of its own for `SILENCE_S`, or for three periods of its loop where these are longer: who replays an
old question cannot take it away from a rig that runs.

A certificate is in time, of its authority, called as it must be, and not revoked. zenoh reads no list of revoked certificates,
and shows of a peer's certificate its common name alone. So a *name* is revoked: its end gets another name and a certificate for
it, and zenoh's access-control list, which names one peer, keeps the old one out.

Reference: NIST SP 800-38B (CMAC); AUTOSAR, Specification of Secure Onboard Communication.
"""

from __future__ import annotations

import os
from binascii import unhexlify
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from hmac import compare_digest
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Final

from msgspec.structs import replace

from transport.links import LOOK_S, BusStatus, Closing, Link, LinkCounters, OnBus, OneOfARole, Role, TransportError
from transport.links.private_directory import read_bounded, read_secret
from transport.wire import CONTROL, HELLO, SENSOR, TAG_BYTES, Tagged, tag_of, with_tag

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

    from transport.can_bus_model.disturbances import BusFault

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


SILENCE_S: Final = 1.0
_SKIPPED: Final = 64
"""So many refused packets are passed over in one call, lest a flood of them holds it for ever."""

Code = Callable[[bytes], bytes]


def read_key(path: str) -> bytes:
    """Return the AES key in a file: 32 or 64 hexadecimal digits, for 128 or 256 bits.

    Raises:
        TransportError: no regular file that is its owner's alone, or other contents.
    """
    try:
        key = unhexlify(read_secret(path, "the key of the frames").strip())
    except ValueError:
        key = b""
    if len(key) not in (16, 32):
        raise TransportError(f"{path}: expected a key of 32 or 64 hexadecimal digits, as `hil keys new` makes one")
    return key


def cmac(key: bytes) -> Code:
    """Return the function that computes AES-CMAC under a key, truncated to 8 bytes.

    >>> cmac(bytes.fromhex("2b7e151628aed2a6abf7158809cf4f3c"))(b"").hex()
    'bb1d6929e9593728'
    """
    with cryptography_needed():
        from cryptography.hazmat.primitives.ciphers.algorithms import AES  # no loop pays for it without a key
        from cryptography.hazmat.primitives.cmac import CMAC

    fresh = CMAC(AES(key)).copy

    def code(data: bytes) -> bytes:
        one = fresh()
        one.update(data)
        return one.finalize()[:TAG_BYTES]

    return code


class AuthenticatedLink(Closing):
    """One end of a link, every packet with its code.

    Args:
        link: what carries the packets.
        role: the rig draws the nonces; the controller takes them over.
        code: the message authentication code, as `cmac` returns it.
        now_s: a monotonic clock, s.
        silence_s: so long a session may be silent before another one takes its controller, s.
    """

    def __init__(
        self, link: Link, role: Role, code: Code, now_s: Callable[[], float] = monotonic, silence_s: float = SILENCE_S
    ) -> None:
        self.uri, self._silence_s = link.uri, silence_s
        self._link, self._rig, self._code, self._now_s = link, role == "rig", code, now_s
        self._receives = CONTROL if self._rig else SENSOR
        self._session: bytes | None = None
        self._last = self._refused = 0
        self._received_s = 0.0

    @property
    def counters(self) -> LinkCounters:
        counters = self._link.counters
        return replace(counters, refused=counters.refused + self._refused)

    def send(self, packet: bytes) -> None:
        if self._rig and packet[4:8] == b"\xff\xff\xff\xff" and packet[8:16] != self._session:
            self._session, self._last = packet[8:16], 0
        session = self._session
        sealed = None if session is None else with_tag(packet, lambda signed: self._code(session + signed))
        if sealed is None:  # no packet, or no session yet: without a code it would be of no use
            self._refused += 1
        else:
            self._link.send(sealed)

    def receive(self, timeout_s: float) -> bytes | None:
        end_s = self._now_s() + (timeout_s if timeout_s > 0 else LOOK_S)
        for _ in range(_SKIPPED):
            data = self._link.receive(timeout_s)
            if data is None:
                return None
            said = tag_of(data)
            if said is not None and said.kind == self._receives and self._accepts(said):
                return data
            self._refused += 1
            left_s = end_s - self._now_s()
            if left_s <= 0:
                return None
            timeout_s = left_s if timeout_s > 0 else 0.0
        return None

    def _accepts(self, packet: Tagged) -> bool:
        """Return whether a packet is of this session, new, and has its code; take over a session that begins."""
        session, last = self._session, self._last
        if not self._rig and packet.seq == HELLO and (nonce := packet.nonce.to_bytes(8, "little")) != session:
            if session is not None and self._now_s() - self._received_s < self._silence_s:
                return False
            session, last = nonce, 0
        counter = packet.counter if packet.seq == HELLO else packet.counter + (1 << 32)
        if session is None or counter <= last or not compare_digest(self._code(session + packet.signed), packet.tag):
            return False
        if session != self._session:
            self._session = session
        self._last = counter
        if not self._rig:
            self._received_s = self._now_s()
        return True

    def check_alone(self) -> None:
        if isinstance(self._link, OneOfARole):
            self._link.check_alone()

    def disturb(self, faults: Sequence[BusFault], seed: int) -> None:
        if not isinstance(self._link, OnBus):
            raise TransportError(f"link {self.uri!r}: no CAN bus whose bits could be disturbed")
        self._link.disturb(faults, seed)

    def statuses(self) -> list[BusStatus]:
        return self._link.statuses() if isinstance(self._link, OnBus) else []

    def close(self) -> None:
        self._link.close()


REVOKED: Final = "revoked"
"""Its name; one name a line."""

_MOST_BYTES: Final = 1 << 20


def revoked_names(ca: str | Path) -> frozenset[str]:
    """Return the names of the list beside the certificate of an authority; none where there is no list.

    Args:
        ca: file of the authority's certificate.

    Raises:
        TransportError: the list cannot be read, is no regular file, no text, or too large.
    """
    path = Path(ca).parent / REVOKED
    if not os.path.lexists(path):
        return frozenset()
    data = read_bounded(path, "a list of revoked names", _MOST_BYTES)
    try:
        text = data.decode()
    except UnicodeDecodeError as error:
        raise TransportError(f"{path}: is no text, not a list of revoked names") from error
    return frozenset(filter(None, map(str.strip, text.splitlines())))


def refuse_revoked(ca: str | Path, *names: str) -> None:
    """Refuse names that are on the list.

    Args:
        ca: file of the authority's certificate.
        names: of certificates.

    Raises:
        TransportError: one is revoked, or the list is none.
    """
    gone = sorted(revoked_names(ca) & set(names))
    if gone:
        raise TransportError(
            f"{Path(ca).parent / REVOKED}: the name {gone[0]} is revoked; `hil keys issue DIR NAME` makes a certificate of "
            "another name, which the link takes with ?rig=NAME or ?controller=NAME"
        )


_REMEDY: Final = "`hil keys renew DIR` makes new ones"


def check_certificate(ca: str, cert: str, name: str, now: datetime | None = None) -> datetime:
    """Refuse a certificate that the other end would refuse; return when it ends.

    zenoh reports to neither end why: the one that connects tries for ever.

    Args:
        ca: file of the authority's certificates, PEM.
        cert: file of this end's certificate, PEM, which those that lead to the authority may follow.
        name: what this end must be called.
        now: instead of the clock's.

    Raises:
        TransportError: expired, not yet valid, of another authority, of another or a revoked name, or no certificate.
    """
    with cryptography_needed():
        from cryptography import x509  # 40 ms that no other link needs

    chains = []
    for path in (ca, cert):
        data = read_bounded(path, "a certificate in PEM", _MOST_BYTES)
        try:
            chains.append(x509.load_pem_x509_certificates(data))
        except ValueError as error:
            raise TransportError(f"{path}: is no certificate in PEM: {error}") from error
    (roots, (own, *between)), now = chains, now or datetime.now(UTC)
    for path, each in ((cert, own), *((cert, one) for one in between), *((ca, root) for root in roots[:1])):
        if now > each.not_valid_after_utc:
            raise TransportError(f"{path}: the certificate expired on {each.not_valid_after_utc:%Y-%m-%d %H:%M} UTC; {_REMEDY}")
        if now < each.not_valid_before_utc:
            begins = f"{each.not_valid_before_utc:%Y-%m-%d %H:%M} UTC"
            raise TransportError(f"{path}: the certificate is not yet valid, but from {begins}; is this machine's clock right?")
    if not any(_issued(own, issuer) for issuer in (*between, *roots)):
        raise TransportError(f"{cert}: is a certificate of another authority than {ca}")
    called = [str(each.value) for each in own.subject.get_attributes_for_oid(x509.NameOID.COMMON_NAME)]
    if name not in called:
        raise TransportError(f"{cert}: is called {', '.join(called) or 'nothing'}, the other end lets in only {name}")
    refuse_revoked(ca, *called)
    return min(each.not_valid_after_utc for each in (own, *between))


def _issued(certificate: Certificate, issuer: Certificate) -> bool:
    from cryptography.exceptions import InvalidSignature

    try:
        certificate.verify_directly_issued_by(issuer)
    except (ValueError, TypeError, InvalidSignature):
        return False
    return True
