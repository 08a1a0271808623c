"""The network laws of an experiment as the delay chains over which its controller is designed, certified and predicted."""

from __future__ import annotations

from collections.abc import Sequence
from math import isqrt, prod
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from design.controllers import GainTable, LoopModel, ages_told, sojourns_told
from design.errors import FieldError
from hil.experiment import Experiment
from hil.rig.packet_ages import Receiver, actuator_of, controller_of, packet_delays, states_at, why_no_ages
from hil.rig.sensor_list import sensors_of
from hil.rig.sensors import shared_media
from transport.laws.delay_states import delay_states
from transport.laws.protocols import NetworkLaw, PacketAges, SemiMarkovLaw

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


def delay_chains(e: Experiment) -> tuple[DelayChain | None, DelayChain | None]:
    """Return the delay chains of both directions, with the labels that the controller tells apart; None where there is none.

    Raises:
        ValueError: the controller asks for more than it can measure over this law.
    """
    chains, ca = node_chains(e), delay_chain(e.links.ca.law, at=actuator_of(e))
    if chains is None:
        return None, ca
    from design.processes.product_chain import product_chain

    return product_chain(chains, [sensor.outputs for sensor in sensors_of(e)], ages_told(e.controller)), ca


def node_chains(e: Experiment, sojourns: int | Sequence[int] | None = None) -> tuple[DelayChain, ...] | None:
    """Return the delay chain of each sensor node by its number.

    None where a law has no chain, where nodes take turns or may keep silent, or where the chains of several nodes together have
    more modes than the theory computes with.

    Args:
        e: checked, its laws loaded.
        sojourns: of one node: lengths of stay with labels of their own; by default those that the controller tells apart.

    Raises:
        ValueError: the controller asks for more than it can measure over this law.
    """
    from design.processes.product_chain import MOST_MODES

    sensors = sensors_of(e)
    if shared_media(e) or any(sensor.trigger.kind != "every-slot" or sensor.clock.every > 1 for sensor in sensors):
        return None
    if sojourns is None:
        sojourns = sojourns_told(e.controller) if len(sensors) == 1 else ()
    chains = [delay_chain(sensor.law, sojourns, at=controller_of(e)) for sensor in sensors]
    known = tuple(chain for chain in chains if chain is not None)
    if len(known) > 1 and any(chain.held is not None for chain in known):
        return None
    if len(known) < len(chains) or (len(known) > 1 and prod(chain.modes for chain in known) > MOST_MODES):
        return None
    return known


def why_no_chain(e: Experiment) -> str:
    """Return what keeps an experiment from having a chain of ages on both links, in words; empty where nothing does.

    Args:
        e: checked, its laws loaded.
    """
    from design.processes.product_chain import MOST_MODES

    sensors = sensors_of(e)
    if shared_media(e):
        return f"nodes share {' and '.join(f'media.{medium.name}' for medium in shared_media(e))}, and take turns"
    for sensor in sensors:
        where = f"nodes.{sensor.name}"
        if sensor.trigger.kind != "every-slot":
            return f"{where}.trigger ({sensor.trigger.kind}) lets a node keep silent"
        if sensor.clock.every > 1:
            return f"{where}.clock: a node sends in one of {sensor.clock.every} slots"
        chain = delay_chain(sensor.law, at=controller_of(e))
        if chain is None:
            return f"the law of {where if e.nodes else 'links.sc'} {why_no_ages(sensor.law, controller_of(e))}"
        if len(sensors) > 1 and chain.held is not None:
            return f"{where}.law is a packet law, whose chain is known for one node alone"
    modes = prod(chain.modes for sensor in sensors if (chain := delay_chain(sensor.law)) is not None)
    if len(sensors) > 1 and modes > MOST_MODES:
        return f"the chains of {len(sensors)} nodes together have {modes} modes, at most {MOST_MODES}"
    if delay_chain(e.links.ca.law, at=actuator_of(e)) is None:
        return f"the law of links.ca {why_no_ages(e.links.ca.law, actuator_of(e))}"
    return ""


def delay_chain(law: NetworkLaw, sojourns: int | Sequence[int] = (), *, at: Receiver | None = None) -> DelayChain | None:
    """Return the chain of the delay that the receiver measures under a network law, None where the law states no chain.

    A receiver keeps the newest packet: where the law's age may grow by more than one per slot it measures another delay.

    Args:
        law: the network law.
        sojourns: semi-Markov laws: so many lengths of stay get labels of their own, in all or per delay 0, 1, ...
        at: who receives; a packet law has a chain at a receiver only.

    Raises:
        ValueError: lengths of stay that nobody can measure, or that say nothing over this law.
    """
    from design.processes.delay_chain import DelayChain

    most = sojourns if isinstance(sojourns, int) else max(sojourns, default=1)
    stays = law if isinstance(law, SemiMarkovLaw) else None
    if most > 1 and stays is None:
        raise FieldError(
            "sojourns", "only a semi-Markov law takes it; over any other law the sojourn time adds no information"
        )
    if at is not None and isinstance(law, PacketAges):
        return packet_delays(law, at)
    states = delay_states(law)
    if states is None:
        return None
    exact = np.array_equal(states.low, states.high)
    between, stay = (None, None) if exact else ((states.low, states.high), states.stays)
    if most == 1 or stays is None:
        return DelayChain(transition=states.matrix, delays=states.ages, between=between, stays=stay)
    if len(set(stays.mode_ages)) < len(stays.mode_ages):
        said = f"several modes have one delay (ages {list(stays.mode_ages)}): the stay at a delay is not that of a mode"
        raise FieldError("sojourns", said)
    if states.has_gaps:
        said = "this delay may grow by more than one per slot: the receiver measures other stays than the law draws"
        raise FieldError("sojourns", said)
    delays, slots = states.ages, states.slots
    longest = [int(slots[delays == d].max(initial=0)) for d in range(int(delays.max()) + 1)]
    counts = [min(n, most) for n in longest] if isinstance(sojourns, int) else list(sojourns)
    if len(counts) < len(longest) or any(n > 0 and not count for n, count in zip(longest, counts)):
        raise FieldError("sojourns", f"{counts}, but the delay reaches {len(longest) - 1}")
    first = np.concatenate([[0], np.cumsum(counts)])[delays]
    labels = first + np.minimum(slots, np.asarray(counts)[delays]) - 1
    return DelayChain(transition=states.matrix, delays=delays, labels=labels, between=between, stays=stay)


def initial_laws(e: Experiment) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return the distributions of the modes of both delay chains in slot 0, None where a law has no chain."""
    ca, sensors, at = states_at(e.links.ca.law, actuator_of(e)), sensors_of(e), controller_of(e)
    known = [states.initial for states in (states_at(sensor.law, at) for sensor in sensors) if states is not None]
    if ca is None or len(known) < len(sensors):
        return None
    from design.processes.product_chain import kron_of

    return kron_of(known), ca.initial


def within_reach(chain: DelayChain, initial: NDArray[np.float64]) -> DelayChain:
    """Return a chain without the modes that it never comes to; the chain itself where it comes to all of them.

    Args:
        chain: the delay chain.
        initial: distribution of its mode in slot 0, (N,).
    """
    follows, reached = chain.bounds[1] > 0.0, np.asarray(initial) > 0.0
    while True:
        more = reached | follows[reached].any(axis=0)
        if np.array_equal(more, reached):
            break
        reached = more
    if reached.all():
        return chain
    from design.processes.delay_chain import DelayChain

    kept = np.flatnonzero(reached)
    inside = np.ix_(kept, kept)
    return DelayChain(
        transition=chain.matrix[inside], delays=chain.delay[kept], labels=chain.label[kept],
        between=None if chain.between is None else (chain.bounds[0][inside], chain.bounds[1][inside]),
        ages=None if chain.ages is None else np.asarray(chain.ages)[kept],
        held=None if chain.held is None else chain.holds[kept],
        stays=None if chain.stays is None else np.asarray(chain.stays)[kept],
    )  # fmt: skip


def without_held(chain: DelayChain | None) -> DelayChain | None:
    """Return a chain for a theory that has no receiver that holds what it had; None where there is such a receiver."""
    return None if chain is None or chain.held is not None else chain


def gains_over(controller: GainTable, model: LoopModel, sc: DelayChain, ca: DelayChain) -> NDArray[np.float64]:
    """Return K[tau, row, m, p] for the delays that two chains reach; a table may cover more (``max_age``)."""
    return gains_within(controller.table(model), controller.selection, sc, ca)


def gains_within(table: NDArray[np.float64], selection: str, sc: DelayChain, ca: DelayChain) -> NDArray[np.float64]:
    """Return the part of a table of gains that the delays of two chains reach."""
    labels, count = int(sc.label.max()) + 1, ca.max_delay + 1
    if sc.holds.any() and (table[labels:] != table[labels - 1]).any():
        raise FieldError("gains", f"{len(table)} tables, but ages beyond {labels - 1} are not told apart; max_age bounds them")
    K = table[:labels]
    if selection == "both":  # a row for every pair of delays
        side = isqrt(K.shape[1])
        return K.reshape(len(K), side, side, *K.shape[2:])[:, :count, :count].reshape(len(K), count * count, *K.shape[2:])
    return K[:, :count] if selection in ("generated", "applied", "previous") else K
