"""What a loop lacks: packets that never come, the first packet of a node that it waits for, commands for the watchdog.

The watchdog stops a run for lack of commands, by losses of the network and by cuts on the time line.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from design.controllers import Controller, HistoryGains, controller_traits
from hil.experiment import Experiment
from hil.rig import RigSpec
from hil.rig.delay_chains import Chains, begun, lasting
from hil.rig.schedules import as_one, no_commands
from transport.laws import AgeChain

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


def never_received(sc: DelayChain | None, ca: DelayChain | None, rig: RigSpec) -> str:
    """Return which packets of a loop never come although they are waited for, and why; empty: packets of each kind come."""
    if sc is not None:
        held = sc.held_outputs(len(rig.outputs))[lasting(sc)[0]]
        for n, sensor in enumerate(rig.sensors):
            if held[:, list(sensor.outputs)].all():
                shared = any(n in medium.nodes for medium in rig.media)
                cause = "on its medium others send in every slot" if shared else "none is in time under its law"
                return f"no sample of {sensor.path} ever comes to the controller: {cause}"
    if ca is not None and ca.holds[lasting(ca)[0]].all():
        return "no command ever comes to the actuator: none is in time under the law of network.ca"
    return ""


def waited_for(controller: Controller, rig: RigSpec) -> tuple[int, ...]:
    """Return the nodes, by number, without whose first packet a controller of several nodes answers zeros.

    Of one node alone, no sample and a sample of zeros are the same to what is linear. Gains over historical data wait for none:
    what has not arrived is zero.

    Args:
        controller: what runs.
        rig: its laws' files read.
    """
    if len(rig.sensors) == 1 or isinstance(controller, HistoryGains):
        return ()
    by_nodes = len(controller_traits(controller).ages) > 1
    silent = rig.nodes.silent if by_nodes else [s.name for s in rig.sensors if s.trigger.kind != "every-slot"]
    return tuple(n for n, sensor in enumerate(rig.sensors) if sensor.name not in silent)


def waiting_chance(sc: DelayChain, waited: Sequence[int], outputs: Sequence[Sequence[int]]) -> tuple[float, int]:
    r"""Return c and the node that is waited for longest: none of its packets has come by slot k with a probability like c^k.

    c is the spectral radius of the chain within the modes in which the node's sample is held: without a first packet it is in
    these except for the first slots.

    Args:
        sc: the chain of the ages of all nodes.
        waited: nodes that are waited for, by number.
        outputs: of each node, the outputs that it measures.
    """
    chances, held = {-1: 0.0}, sc.held_outputs(sum(map(len, outputs)))
    for node in waited:
        inside = np.flatnonzero(held[:, list(outputs[node])].all(axis=1))
        if len(inside):
            chances[node] = float(np.abs(np.linalg.eigvals(sc.bounds[1][np.ix_(inside, inside)])).max())
    longest = max(chances, key=lambda node: chances[node])
    return chances[longest], longest


STOPPED = 1e-3
"""Share of the runs that the watchdog may stop without being named."""
NEGLIGIBLE, MOST_SLOTS, MIXED = 1e-12, 100_000, 1024


def percent(share: float) -> str:
    """Return a share with two digits, in words.

    >>> percent(0.9999), percent(0.0123)
    ('100 %', '1.2 %')
    """
    return f"{float(f'{100.0 * share:.2g}'):g} %"


def watchdog_chance(chains: Chains, experiment: Experiment, d_max: int) -> float:
    """Return the probability that a run ends because the actuator holds no packet that its rows cover for too many slots.

    Args:
        chains: of the rig.
        experiment: with its watchdog and its number of slots.
        d_max: largest delay that a packet has a row for; until that slot nothing is missing.
    """
    chain, initial, most = chains.ca, begun((chains.applied,)), experiment.limits.watchdog_slots
    if chain is None or initial is None or not chain.holds.any() or most > experiment.slots:
        return 0.0
    waits, goes_on, alive = chain.holds, 1.0, np.array([initial])  # a row for every number of slots without one so far
    for k in range(1, slots := min(experiment.slots, MOST_SLOTS)):
        before, alive = alive, alive @ chain.matrix
        if k > d_max:
            alive = np.vstack([np.where(waits, 0.0, alive).sum(axis=0), np.where(waits, alive, 0.0)])[:most]
            alive = alive[: int(np.flatnonzero(alive.sum(axis=1) > NEGLIGIBLE).max(initial=0)) + 1]
        share = float(alive.sum())
        goes_on, alive = goes_on * share, alive / max(share, NEGLIGIBLE)
        if goes_on < STOPPED:
            break
        if k > d_max and alive.shape == before.shape and np.abs(alive - before).max() < NEGLIGIBLE:  # from here on alike
            goes_on *= share ** (slots - 1 - k)
            break
    return max(0.0, 1.0 - goes_on)


def chance_behind_cuts(chains: Chains, experiment: Experiment, d_max: int) -> float:
    """Return about the probability that the watchdog trips by cuts of the way to the actuator, 0 over an age law.

    A cut begins with a command of some age in use, which serves until it is too old, or with some slots that lacked one already.
    Behind it those slots lack one in which none has come that was sent since its end, less the shortest latency: what was sent
    before counts as lost. Where nothing is sent, nothing comes for as long, a shortest latency later.

    Args:
        chains: of the rig.
        experiment: with its watchdog and its faults.
        d_max: largest delay that a packet has a row for.
    """
    law, most = chains.applied.ages, experiment.limits.watchdog_slots
    if not no_commands(experiment) or not isinstance(law, AgeChain):
        return 0.0
    ages, matrix, chance = np.array(law.mode_ages), law.transition_matrix(), 0.0
    usual = law.initial_law() @ np.linalg.matrix_power(matrix, MIXED)
    youngest, in_use = int(ages[usual > NEGLIGIBLE].min()), ages <= d_max

    def lacks(slots: int, weights: NDArray[np.float64], oldest: Callable[[int], int]) -> NDArray[np.float64]:
        found = [1.0]
        for k in range(slots):
            weights = np.where(ages > oldest(k), weights if k == 0 else weights @ matrix, 0.0)
            found.append(float(weights.sum()))
        return np.array(found)

    before = lacks(most, usual, lambda k: d_max)
    behind = lacks(youngest + most + d_max, law.initial_law(), lambda k: min(k, d_max))[youngest:]
    for first, end in as_one(no_commands(experiment, youngest, youngest)):
        left = most - (end - first)
        chance += float(usual[in_use] @ behind[np.maximum(left + d_max - ages[in_use], 0)]) + float(before[max(left, 1)])
        chance += float((before[1:left] - before[2 : left + 1]) @ behind[left - 1 : 0 : -1]) if left > 1 else 0.0
    return min(1.0, chance)
