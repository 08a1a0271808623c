"""The network laws of a rig as the delay chains over which its controller is designed, certified and predicted."""

from __future__ import annotations

from collections.abc import Sequence
from math import isqrt, prod
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import GainTable, LoopModel, controller_traits, row_count
from design.errors import FieldError
from hil.rig import RigSpec
from hil.rig.receiver import Received, received
from transport.laws import NetworkLaw, SemiMarkovLaw
from transport.laws.delay_states import DelayStates, delay_states
from transport.wire import MAX_ROWS

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


class Chains(Struct, frozen=True, kw_only=True):
    """The delay chains of a rig, with the labels that its controller distinguishes.

    Args:
        arriving: the law of each sensor node, by number, as the controller meets it.
        applied: the law to the actuator, as the actuator meets it.
        nodes: the delay chain of each sensor node by its number. None where a law has no chain, where nodes take turns or may
            keep silent, or where the chains of several nodes together have more modes than the theory computes with.
        sc: the chain of all nodes together; None where `nodes` is.
        ca: the chain of the actuator; None where its law has none.
        why_none: the reason why the rig does not have both, a phrase; empty where it has.
    """

    arriving: tuple[Received, ...]
    applied: Received
    nodes: tuple[DelayChain, ...] | None
    sc: DelayChain | None
    ca: DelayChain | None
    why_none: str

    def initial(self) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return the distributions of the modes of both chains in slot 0, None where a law has no chain."""
        sc, ca = begun(self.arriving), begun((self.applied,))
        return None if sc is None or ca is None else (sc, ca)

    def neglects(self) -> str:
        """Return what the chains neglect, a phrase; empty where they are exact."""
        return next(filter(None, (way.neglects() for way in (*self.arriving, self.applied))), "")


def begun(ways: Sequence[Received]) -> NDArray[np.float64] | None:
    """Return the distribution of the modes of some laws together in slot 0, None where one of them has no chain."""
    from design.processes.delay_chain import kron_of

    known = [way.states.initial for way in ways if way.states is not None]
    return kron_of(known) if len(known) == len(ways) else None


def chains_for(rig: RigSpec, controller: object) -> Chains:
    """Return the delay chains of a rig, with the labels that a controller distinguishes.

    Raises:
        ValueError: the controller asks for more than it can measure over this law.
    """
    its = controller_traits(controller)
    return chains_of(rig, its.sojourns if len(rig.sensors) == 1 else (), its.ages, its.row_sojourns)


def chains_of(rig: RigSpec, sojourns: int | Sequence[int] = (), ages: Sequence[int] = (), row_sojourns: int = 1) -> Chains:
    """Return the delay chains of a rig.

    Args:
        rig: its laws' files read.
        sojourns: of one node: lengths of stay with labels of their own.
        ages: of several nodes: how many ages of each are distinguished; none: by the oldest sample alone.
        row_sojourns: lengths of stay at every d with labels of their own: d row_sojourns, and those after it.

    Raises:
        ValueError: lengths of stay that cannot be measured, or that say nothing over this law.
    """
    from design.processes.delay_chain import product_chain

    if row_sojourns > 1 and (rows := row_count("applied", rig.at_actuator.max_age, row_sojourns)) > MAX_ROWS:
        raise FieldError("row_sojourns", f"{row_sojourns} needs {rows} rows, a packet carries {MAX_ROWS}")
    stays = 1 if isinstance(sojourns, int) else max(sojourns, default=1)
    arriving = tuple(received(f"{sensor.path}.law", sensor.law, rig.at_controller, stays) for sensor in rig.sensors)
    applied = received("network.ca.law", rig.ca_law, rig.at_actuator, row_sojourns)
    silent = _why_silent(rig)
    chains = () if silent else [chain_of(way, sojourns) for way in arriving]
    known = tuple(chain for chain in chains if chain is not None)
    why_none = silent or _why_no_chain(rig, arriving)
    nodes = None if why_none else known
    ca = chain_of(applied, (row_sojourns,) * (rig.at_actuator.max_age + 1) if row_sojourns > 1 else (), "row_sojourns")
    if not why_none and ca is None:
        why_none = f"the law of network.ca {applied.why_none}"
    sc = None if nodes is None else product_chain(nodes, [sensor.outputs for sensor in rig.sensors], tuple(ages))
    return Chains(arriving=arriving, applied=applied, nodes=nodes, sc=sc, ca=ca, why_none=why_none)


def _why_silent(rig: RigSpec) -> str:
    """Return the reason why a node may be silent in a slot, a phrase; empty where none may."""
    if rig.media:
        return f"nodes share {' and '.join(f'network.media.{medium.name}' for medium in rig.media)}, and take turns"
    for sensor in rig.sensors:
        if sensor.trigger.kind != "every-slot":
            return f"{sensor.path}.trigger ({sensor.trigger.kind}) lets a node keep silent"
        if sensor.clock.every > 1:
            return f"{sensor.path}.clock: a node sends in one of {sensor.clock.every} slots"
    return ""


def _why_no_chain(rig: RigSpec, arriving: Sequence[Received]) -> str:
    """Return why nodes that send in every slot have no chain together, in words; empty where they have one."""
    from design.processes.delay_chain import MOST_MODES

    for sensor, way in zip(rig.sensors, arriving):
        if way.states is None:
            return f"the law of {sensor.path} {way.why_none}"
    modes = prod(len(way.states.ages) for way in arriving if way.states is not None)
    if len(arriving) > 1 and modes > MOST_MODES:
        return f"the chains of {len(arriving)} nodes together have {modes} modes, at most {MOST_MODES}"
    return ""


def chain_of(way: Received, sojourns: int | Sequence[int] = (), field: str = "sojourns") -> DelayChain | None:
    """Return the chain of the delay that a receiver measures, None where there is none; see `delay_chain`."""
    if way.of_packets:
        _refuse_sojourns(way.law, sojourns, field)
        return way.delays()
    return delay_chain(way.law, sojourns, states=way.states, field=field)


def _refuse_sojourns(law: NetworkLaw, sojourns: int | Sequence[int], field: str) -> int:
    """Return the most lengths of stay that are distinguished."""
    most = sojourns if isinstance(sojourns, int) else max(sojourns, default=1)
    if most > 1 and not isinstance(law, SemiMarkovLaw):
        raise FieldError(field, "only a semi-Markov law takes it; over any other law the sojourn time adds no information")
    return most


def delay_chain(
    law: NetworkLaw, sojourns: int | Sequence[int] = (), *, states: DelayStates | None = None, field: str = "sojourns"
) -> DelayChain | None:
    """Return the chain of the delay that the receiver measures under an age law, None where the law states no chain.

    A receiver keeps the newest packet: where the law's age may grow by more than one per slot it measures another delay.

    Args:
        law: the network law.
        sojourns: semi-Markov laws: so many lengths of stay get labels of their own, in all or per delay 0, 1, ...
        states: of the law, where they are known; they have states for as many lengths of stay.
        field: by which an error names the lengths of stay.

    Raises:
        ValueError: lengths of stay that cannot be measured, or that say nothing over this law.
    """
    from design.processes.delay_chain import DelayChain

    most = _refuse_sojourns(law, sojourns, field)
    states = delay_states(law, 1 if isinstance(sojourns, int) else most) if states is None else states
    if states is None:
        return None
    stays = law if isinstance(law, SemiMarkovLaw) else None
    exact = np.array_equal(states.low, states.high)
    between, stay = (None, None) if exact else ((states.low, states.high), states.stays)
    if most == 1 or stays is None:
        return DelayChain(transition=states.matrix, delays=states.ages, between=between, stays=stay)
    if len(set(stays.mode_ages)) < len(stays.mode_ages):
        said = f"several modes have one delay (ages {list(stays.mode_ages)}): the stay at a delay is not that of a mode"
        raise FieldError(field, said)
    if states.has_gaps:
        said = "this delay may grow by more than one per slot: the receiver measures other stays than the law draws"
        raise FieldError(field, said)
    delays, slots = states.ages, states.slots
    longest = [int(slots[delays == d].max(initial=0)) for d in range(int(delays.max()) + 1)]
    counts = [min(n, most) for n in longest] if isinstance(sojourns, int) else list(sojourns)
    if len(counts) < len(longest) or any(n > 0 and not count for n, count in zip(longest, counts)):
        raise FieldError(field, f"{counts}, but the delay reaches {len(longest) - 1}")
    going_on = np.flatnonzero((states.high.diagonal() > 0.0) & (slots < np.asarray(counts)[delays]))
    if len(going_on):
        at = going_on[0]
        raise FieldError(field, f"{counts[delays[at]]} for the delay {delays[at]}, whose stays have {slots[at]} states at most")
    first = np.concatenate([[0], np.cumsum(counts)])[delays]
    labels = first + np.minimum(slots, np.asarray(counts)[delays]) - 1
    return DelayChain(transition=states.matrix, delays=delays, labels=labels, between=between, stays=stay)


def within_reach(chain: DelayChain, initial: NDArray[np.float64]) -> DelayChain:
    """Return a chain without the modes that it never reaches; the chain itself where it reaches all.

    Args:
        chain: the delay chain.
        initial: distribution of its mode in slot 0, (N,).
    """
    from design.jump_linear.order_of_modes import led_to

    reached = led_to(chain.bounds[1] > 0.0, np.asarray(initial) > 0.0)
    begins = None if chain.begins is None else np.asarray(initial)[reached] > 0.0
    if reached.all():
        return chain if begins is None else replace(chain, begins=begins)
    from design.processes.delay_chain import DelayChain

    kept = np.flatnonzero(reached)
    inside = np.ix_(kept, kept)
    return DelayChain(
        transition=chain.matrix[inside], delays=chain.delay[kept], labels=chain.label[kept],
        between=None if chain.between is None else (chain.bounds[0][inside], chain.bounds[1][inside]),
        ages=None if chain.ages is None else np.asarray(chain.ages)[kept],
        held=None if chain.held is None else np.asarray(chain.held)[kept],
        stays=None if chain.stays is None else np.asarray(chain.stays)[kept], begins=begins,
    )  # fmt: skip


def without_held(chain: DelayChain | None) -> DelayChain | None:
    """Return a chain for a theory in which no receiver holds its last packet; None where the receiver of this chain may hold.

    The transient modes of the first slots, in which no packet had time to come, are left out.
    """
    if chain is None or chain.held is None:
        return chain
    kept = within_reach(chain, lasting(chain)[0].astype(np.float64))
    return None if kept.holds.any() else replace(kept, held=None, labels=None)


def lasting(chain: DelayChain) -> tuple[NDArray[np.bool_], int]:
    """Return which modes of a chain do not belong to its transient first slots, (N,), and the number of these slots."""
    follows, lasts, slots = chain.bounds[1] > 0.0, np.ones(chain.modes, dtype=np.bool_), 0
    while not np.array_equal(after := lasts & follows[lasts].any(axis=0), lasts):
        lasts, slots = after, slots + 1
    return lasts, slots


def gains_over(controller: GainTable, model: LoopModel, sc: DelayChain, ca: DelayChain) -> NDArray[np.float64]:
    """Return K[tau, row, m, p] for the delays that two chains reach; a table may cover more (``max_age``)."""
    return gains_within(controller.table(model), controller.selection, sc, ca)


def state_gains_within(controller: object, sc: DelayChain) -> NDArray[np.float64]:
    """Return of a controller's own state the gains of the tables that a chain reaches; empty where it has no state."""
    found = np.asarray(controller_traits(controller).state_gains, dtype=np.float64)
    return _reached(found, sc) if found.size else found


def _reached(table: NDArray[np.float64], sc: DelayChain) -> NDArray[np.float64]:
    labels = int(sc.label.max()) + 1
    if sc.ages is None and sc.holds.any() and (table[labels:] != table[labels - 1]).any():
        raise FieldError("gains", f"{len(table)} tables, but ages beyond {labels - 1} are not distinguished; max_age bounds them")
    return table[:labels]


def gains_within(table: NDArray[np.float64], selection: str, sc: DelayChain, ca: DelayChain) -> NDArray[np.float64]:
    """Return the part of a table of gains that the delays of two chains reach."""
    K, count = _reached(table, sc), int(ca.label.max()) + 1
    if selection == "both":  # a row for every pair of delays
        side = isqrt(K.shape[1])
        return K.reshape(len(K), side, side, *K.shape[2:])[:, :count, :count].reshape(len(K), count * count, *K.shape[2:])
    return K[:, :count] if selection in ("generated", "applied", "previous") else K
