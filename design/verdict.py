"""What is claimed, of which system, by what proof.

Every claim that a run carries is a :class:`Verdict`, whatever theory it comes from. ``certified`` is a proof for the very
system whose digest it names; ``refused`` is a proof of the contrary; ``undecided`` says that the theory does not know.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Final, Literal

import msgspec
import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace

from design.errors import FieldError

Kind = Literal["mean-square stability", "practical stability", "stability in a region", "L2 gain", "guaranteed cost", "passivity"]
State = Literal["certified", "refused", "undecided"]


def digest(system: Mapping[str, object]) -> str:
    """Return the SHA-256 of a system: its name to value, numbers and arrays bit by bit, in the order of the names.

    Raises:
        FieldError: a table whose keys have no order.

    >>> digest({"A": np.eye(2)}) == digest({"A": [[1.0, 0.0], [0.0, 1.0]]})
    True
    >>> digest({"plant": {"table": {1: 0.5, "a": 0.0}}})
    Traceback (most recent call last):
    design.errors.FieldError: plant.table: keys without an order (int, str), expected keys of one type, such as text
    """

    def plain(value: object, path: str = "") -> object:
        if isinstance(value, Mapping):
            try:
                return {str(k): plain(v, f"{path}.{k}" if path else str(k)) for k, v in sorted(value.items())}
            except TypeError:
                kinds = ", ".join(sorted({type(key).__name__ for key in value}))
                raise FieldError(path, f"keys without an order ({kinds}), expected keys of one type, such as text") from None
        if isinstance(value, np.ndarray | np.generic):
            return plain(value.tolist(), path)
        if isinstance(value, list | tuple):
            return [plain(v, path) for v in value]
        return float(value).hex() if isinstance(value, int | float) and not isinstance(value, bool) else value

    return hashlib.sha256(msgspec.json.encode(plain(system))).hexdigest()


class Verdict(Struct, frozen=True, kw_only=True):
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

    def assuming(self, *assumptions: str) -> Verdict:
        """Return it with further assumptions, each once."""
        return replace(self, assumptions=tuple(dict.fromkeys((*self.assumptions, *assumptions))))

    def undecided(self, reason: str) -> Verdict:
        """Return it as undecided, for this reason; one that is undecided keeps its own."""
        if self.state == "undecided":
            return self
        return replace(self, state="undecided", reason=reason, details={**self.details, "stable": False})

    def to_json(self) -> dict[str, object]:
        """Return the verdict as a dictionary that ``json.dumps`` takes; the details stand beside the other keys."""
        own = {
            "kind": self.kind, "state": self.state, "reason": self.reason, "number": self.number, "quantity": self.quantity,
            "limit": self.limit, "assumptions": list(self.assumptions), "method": self.method, "digest": self.digest,
        }  # fmt: skip
        return {**{name: value for name, value in self.details.items() if name not in own}, **own}

    def on_every_machine(self) -> dict[str, object]:
        """Return `to_json` with the digits that every CPU computes alike, and ``precision``, which says how many they are.

        What an interior-point solver came to is left as it is, and named.
        """
        found = [name for name in FROM_A_SOLVER if self.details.get("solver") and self.to_json().get(name) is not None]
        said = {name: value if name in found else _rounded(value, name) for name, value in self.to_json().items()}
        return {**said, "precision": PRECISION + (f"; {', '.join(found)}: to some per cent, by a solver" if found else "")}


DIGITS: Final = 10
DECIMALS: Final = 10
FROM_A_SOLVER: Final = ("number", "margin", "decay_rate", "gamma")
NEAR_ZERO: Final = ("residual", "h2_residual", "hinf_margin", "rounding")
"""Numbers that are differences of others: decimals count, and not digits."""
PRECISION: Final = f"{DIGITS} digits, of residuals {DECIMALS} decimals, alike on every CPU"


def _rounded(value: object, name: str = "") -> object:
    if isinstance(value, Mapping):
        return {key: _rounded(each, str(key)) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(each, name) for each in value]
    if not isinstance(value, float | np.floating) or not np.isfinite(value):
        return value
    return round(float(value), DECIMALS) + 0.0 if name in NEAR_ZERO else float(f"{value:.{DIGITS}g}")
