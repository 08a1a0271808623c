"""Whether the answers that a log holds carry the codes of a key: who had no key can have made none of them."""

from __future__ import annotations

from dataclasses import dataclass
from hmac import compare_digest
from pathlib import Path

from hil.errors import HilError
from hil.log.run import Run
from hil.log.topics import CONTROL
from hil.replay.compare import BATCH
from hil.replay.recorded import frames, recorded_wire
from hil.runtime.nodes.wire import before
from transport.links.authenticated_link import cmac, read_key
from transport.wire.tags import tag_of


@dataclass(frozen=True, slots=True, kw_only=True)
class Tags:
    """What the tags of a log say.

    Args:
        verified: answers, late ones too, whose tag is that of the key.
        wrong: answers without a tag, or with another one.
        first: slot of the first of those, None if there is none.
    """

    verified: int
    wrong: int
    first: int | None


def verify_tags(run: Run, key: Path, source: str = "log") -> Tags:
    """Compute the tag of every recorded answer again.

    The nonce of the session, which every code covers, is that from which the nonce of slot 0 follows.

    Args:
        run: the log.
        key: the key of the frames, as `hil keys new` makes it.
        source: the log's name, for messages.

    Raises:
        HilError: the log has no nonce of slot 0: no real link was there.
        TransportError: the file is no key, or others can read it.
    """
    code, first_nonce = cmac(read_key(str(key))), recorded_wire(run).nonce(0)
    if not first_nonce:
        raise HilError(f"{source}: has no nonce of slot 0, so no session over a link; --auth needs one with auth=")
    session = before(first_nonce).to_bytes(8, "little")
    verified, wrong = 0, 0
    first: int | None = None
    for tick, data in frames(run.pieces(CONTROL.name, BATCH)):
        said = tag_of(data)
        if said is not None and compare_digest(code(session + said.signed), said.tag):
            verified += 1
        else:
            wrong += 1
            first = tick if first is None else first
    return Tags(verified=verified, wrong=wrong, first=first)
