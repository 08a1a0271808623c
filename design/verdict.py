"""What is claimed, of which system, by what proof.

Every claim that a run carries is a :class:`Verdict`, whatever theory it comes from. ``certified`` is a proof for the very
system whose digest it names; ``refused`` is a proof of the contrary; ``undecided`` says that the theory does not know.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import msgspec
import numpy as np

Kind = Literal["mean-square stability", "practical stability", "L2 gain", "guaranteed cost", "passivity"]
State = Literal["certified", "refused", "undecided"]


def digest(system: Mapping[str, object]) -> str:
    """Return the SHA-256 of a system: its name to value, numbers and arrays bit by bit, in the order of the names.

    >>> digest({"A": np.eye(2)}) == digest({"A": [[1.0, 0.0], [0.0, 1.0]]})
    True
    """

    def plain(value: object) -> object:
        if isinstance(value, Mapping):
            return {str(k): plain(v) for k, v in sorted(value.items())}
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist())
        if isinstance(value, list | tuple):
            return [plain(v) for v in value]
        return float(value).hex() if isinstance(value, int | float) and not isinstance(value, bool) else value

    return hashlib.sha256(msgspec.json.encode(plain(system))).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """A claim on one system and what decides it.

    Args:
        kind: what is claimed.
        state: ``certified``, ``refused`` or ``undecided``; only the first lets a loop run without ``allow_uncertified``.
        reason: what decided, in one sentence.
        number: the number that decides, such as a spectral radius; None where nothing was computed.
        quantity: what that number is, with its unit where it has one.
        limit: the value that the number must stay below; None where nothing was computed.
        assumptions: what the claim rests on.
        method: who proved it: the theorem or the computation.
        digest: SHA-256 of the system that the claim is about, see :func:`digest`.
        details: further numbers, such as norms and margins, by name.
    """

    kind: Kind
    state: State
    reason: str
    number: float | None = None
    quantity: str = ""
    limit: float | None = None
    assumptions: tuple[str, ...] = ()
    method: str = ""
    digest: str = ""
    details: Mapping[str, object] = field(default_factory=dict)

    @property
    def certified(self) -> bool:
        """Whether the claim is proved."""
        return self.state == "certified"

    def to_json(self) -> dict[str, object]:
        """Return the verdict as a dictionary that ``json.dumps`` takes; the details stand beside the other keys."""
        own = {
            "kind": self.kind, "state": self.state, "reason": self.reason, "number": self.number, "quantity": self.quantity,
            "limit": self.limit, "assumptions": list(self.assumptions), "method": self.method, "digest": self.digest,
        }  # fmt: skip
        return {**{name: value for name, value in self.details.items() if name not in own}, **own}
