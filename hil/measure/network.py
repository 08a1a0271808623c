"""What the emulated network did, counted from the records of its draws."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from hil.log.append_column import pieces
from transport.draws import REASONS
from transport.law_tests.statistics import law_p_value, mode_counts, transition_counts
from transport.laws.delay_states import mode_shares, mode_transitions
from transport.laws.protocols import NetworkLaw

Draws: TypeAlias = npt.NDArray[np.void]

MOST_MODES: Final = 256
"""Modes beyond which they are not counted: a foreign log may name any number as a mode, and pairs take its square."""


def mode_sequence(draws: Draws) -> npt.NDArray[np.int64]:
    """Return the modes that the law drew, one per slot in slot order (rows with mode < 0 book a packet's fate)."""
    parts = [modes[modes >= 0].astype(np.int64) for modes in (piece["mode"] for piece in pieces(draws))]
    return np.concatenate(parts) if parts else np.empty(0, np.int64)


def network_metrics(
    draws: Draws | None, law: NetworkLaw | None, kind: str, *, late: int = 0, reasons: Sequence[str] = REASONS,
    slot: tuple[float, float] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Return the network part of a summary, for one direction.

    Args:
        draws: records of `/network/sc` or `/network/ca`; None if they were not kept.
        law: the network law's parameters, None if they cannot be made again here (its plug-in is gone).
        kind: its plug-in name.
        late: packets that missed the slot's deadline (they count as lost on the way to the actuator).
        reasons: names of the codes in `draws["reason"]`.
        slot: its length and when it closes, s; None where that is not known.

    Returns:
        law (its kind), mode_counts, transition_counts (row: from; both empty above `MOST_MODES`), p_value (None where the law
        has no test or the record is too short), lost (by the loss law or a full queue), late, duplicated, fates (reason: count).
    """
    found: dict[str, Any] = {"law": kind, "mode_counts": [], "transition_counts": [], "p_value": None}
    fates: dict[str, int] = {}
    if draws is not None and len(draws):
        modes = mode_sequence(draws)
        expected = expected_frequencies(law)
        size = max(0 if expected is None else len(expected), int(modes.max(initial=-1)) + 1)
        if 0 < size <= MOST_MODES:
            found["mode_counts"] = mode_counts(modes, size).tolist()
            found["transition_counts"] = transition_counts(modes, size).tolist()
        found["p_value"] = _p_value(law, modes, draws, slot)
        counts = np.sum([np.bincount(piece["reason"], minlength=256) for piece in pieces(draws)], axis=0)
        fates = {reasons[c] if c < len(reasons) else str(c): int(counts[c]) for c in np.flatnonzero(counts).tolist()}
    found["lost"] = fates.get("lost", 0) + fates.get("overflow", 0)
    found["late"] = late
    found["duplicated"] = fates.get("duplicated", 0)
    found["fates"] = fates
    return found


def expected_transitions(law: NetworkLaw | None) -> npt.NDArray[np.float64] | None:
    """Return the transition matrix that the law states for its modes, None where it is no Markov chain."""
    return _stated(law, mode_transitions)


def expected_frequencies(law: NetworkLaw | None) -> npt.NDArray[np.float64] | None:
    """Return the stationary frequency of every mode that the law states, None where it states none."""
    return _stated(law, mode_shares)


def _stated(law: NetworkLaw | None, of: Callable[[object], npt.NDArray[np.float64] | None]) -> npt.NDArray[np.float64] | None:
    try:
        return of(law)
    except ValueError:  # for instance a chain with several closed classes has no single stationary law
        return None


def _p_value(
    law: NetworkLaw | None, modes: npt.NDArray[np.int64], draws: Draws, slot: tuple[float, float] | None
) -> float | None:  # fmt: skip
    if law is None:
        return None
    try:
        p_value = law_p_value(law, modes, pieces(draws), slot)
    except ValueError:  # a recorded trace whose file is no longer where it was
        return None
    return p_value if math.isfinite(p_value) else None
