"""The delay chains that a certifier takes: those of a design, and those that a certifier alone computes with."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import gcd
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import (
    AgedFeedback,
    Controller,
    GainTable,
    HistoryGains,
    LinearFeedback,
    LoopModel,
    controller_traits,
    row_count,
)
from design.errors import FieldError
from hil.rig import RigSpec
from hil.rig.can_bus import can_bus_of
from hil.rig.delay_chains import Chains, begun, lasting, within_reach
from hil.rig.receiver import Received, recorded_chain
from hil.rig.slotted_media import slotted
from transport.errors import NotKnown
from transport.laws import RecordedLaw

if TYPE_CHECKING:
    from design.historical_data.sensor_schedule import PhaseGains
    from design.processes.delay_chain import DelayChain


OLDEST_DISTINGUISHED = 16
"""Ages that are distinguished for a controller whose matrices all of them change."""


ANY_PHASE = "directions or clocks repeat, and any of their phases may meet"
IN_PHASE = "both directions repeat, and meet in the phases in which they begin in slot 0"


class LoopChains(NamedTuple):
    """Both chains, None where there is none; which modes of the laws never occur; why a chain is missing; empty for nothing.

    `history`: the gains over historical data in every phase of what is known and of the command that acts; what about them is not
    known, in words; None for other controllers.

    `slack` bounds the difference of each output, at the controller, from the measured one, by dead bands; `shares` bounds it as a
    share of the output, by relative triggers; empty: no node has such a trigger.
    """

    sc: DelayChain | None
    ca: DelayChain | None
    unmet: str
    chainless: str
    slack: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    history: PhaseGains | str | None = None


def loop_chains(
    rig: RigSpec, chains: Chains, controller: Controller, model: LoopModel, *, in_phase: bool = True
) -> LoopChains:
    """Return the chains of both delays of a loop as it runs.

    Args:
        rig: its laws' files read.
        chains: those that designs take, with the labels of this controller.
        controller: what runs.
        model: what it knows of the loop.
        in_phase: whether the laws of the sensor nodes begin with their clocks; else any of their phases may meet.
    """
    if isinstance(controller, HistoryGains):
        return LoopChains(chains.sc, chains.ca, "", "", history=history_of(rig, chains, controller, model, in_phase=in_phase))
    if can_bus_of(rig) is not None:
        try:
            return _over_bus(rig, chains, controller, model)
        except NotKnown as why:
            return LoopChains(None, None, "", str(why))
    if (both := reached(chains)) is not None and chains.sc is not None and chains.ca is not None:
        never = chains.sc.modes + chains.ca.modes - sum(chain.modes for chain in both)
        unmet = f"the network begins as its laws state: it never comes to {never} of their modes" if never else ""
        return LoopChains(*both, unmet, "")
    sc = None if chains.sc is None else _begins(chains.sc, chains.arriving)
    ca = None if chains.ca is None else _begins(chains.ca, (chains.applied,))
    drawn = sc is not None, ca is not None
    its = controller_traits(controller)
    if its.sojourns or (ca is None and its.row_sojourns > 1):
        return LoopChains(sc, ca, "", chains.why_none)
    if ca is None:
        if not isinstance(rig.ca_law, RecordedLaw):
            return LoopChains(sc, None, "", chains.why_none if sc is not None else "the law of network.ca states no chain")
        try:
            ca = recorded_chain(rig.ca_law)
        except NotKnown as why:
            return LoopChains(sc, None, "", str(why))
    if sc is None:
        from hil.rig.received_ages import received_ages

        distinguished = _distinguished(controller, model)
        try:
            bands = _beside_bands(rig, controller, distinguished)
            found = received_ages(rig, chains.arriving, distinguished, bands=bands, in_phase=in_phase)
        except NotKnown as why:
            return LoopChains(None, ca, "", str(why))
        return LoopChains(*settled(*_in_phase(found, ca, drawn)), "", "", *_slack(rig))
    return LoopChains(*settled(*_in_phase(sc, ca, drawn)), "", "")


def history_of(
    rig: RigSpec, chains: Chains, controller: HistoryGains, model: LoopModel, *, in_phase: bool = True
) -> PhaseGains | str:
    """Return the gains over historical data of every phase, as they act; in words, why they are not known.

    Where the schedule alone says what is known, its turns are the phases (`design.historical_data.sensor_schedule`); elsewhere
    the phases are the states of `hil.rig.known_samples`.

    Args:
        rig, chains, controller, model, in_phase: as of `loop_chains`.
    """
    from design.historical_data.sensor_schedule import gains_undecided, phase_gains
    from hil.rig.known_samples import phases_over, with_commands

    nodes, K = model.nodes, np.array(controller.history(), dtype=float)
    if triggered := [sensor.name for sensor in rig.sensors if sensor.trigger.kind != "every-slot"]:
        return f"the theory does not know when the triggers or clocks of the nodes {', '.join(triggered)} let them send"
    try:
        ca, first = _commands(rig, chains)
        if nodes.silent or gains_undecided(K, nodes, controller.uses):
            found = phases_over(rig, chains.arriving, controller, nodes, in_phase=in_phase)
        else:
            found = phase_gains(K, nodes, controller.uses)
            if not in_phase and nodes.turns is not None and nodes.turns.cycle:
                begins = [replace(nodes, turns=replace(nodes.turns, phase=at)) for at in range(nodes.turns.phases)]
                starts = [phase_gains(K, each, controller.uses).start for each in begins]
                found = replace(found, start=np.mean(starts, axis=0))
        return with_commands(found, ca, first)
    except (NotKnown, FieldError) as why:
        return str(why)


def _commands(rig: RigSpec, chains: Chains) -> tuple[DelayChain, NDArray[np.float64]]:
    """The chain of the ages of commands, and its distribution in slot 0.

    Raises:
        NotKnown: there is none.
    """
    if chains.ca is not None and (first := begun((chains.applied,))) is not None:
        return chains.ca, first
    if not isinstance(rig.ca_law, RecordedLaw):
        raise NotKnown(f"the law of network.ca {chains.applied.why_none}")
    recorded = recorded_chain(rig.ca_law)
    return recorded, np.asarray(recorded.begins, dtype=np.float64)


def reached(chains: Chains) -> tuple[DelayChain, DelayChain] | None:
    """Return both chains of a design with the modes that a run reaches, in the phases in which these meet; None without both."""
    if chains.sc is None or chains.ca is None:
        return None
    return _in_phase(_begins(chains.sc, chains.arriving), _begins(chains.ca, (chains.applied,)), (True, True))


def _begins(chain: DelayChain, ways: Sequence[Received]) -> DelayChain:
    """The chain with the modes that it reaches, and those in which it may begin."""
    first = begun(ways)
    return chain if first is None else within_reach(replace(chain, begins=first > 0.0), first)


def _in_phase(sc: DelayChain, ca: DelayChain, drawn: tuple[bool, bool]) -> tuple[DelayChain, DelayChain]:
    """Both chains; those that are drawn may be in any mode, unless both repeat, so that only some pairs of modes come about.

    Args:
        sc, ca: the chains.
        drawn: of each whether a law draws it.
    """
    from design.jump_linear.order_of_modes import cyclic_classes, strong_classes

    periods = []
    for follows in (chain.bounds[1] for chain in settled(sc, ca)):
        periods.append([len(cyclic_classes(follows[np.ix_(own, own)])) for own in strong_classes(follows)])
    if any(gcd(*pair) > 1 for pair in product(*periods) if all(pair)):
        return sc, ca
    return replace(sc, begins=None) if drawn[0] else sc, replace(ca, begins=None) if drawn[1] else ca


def _over_bus(rig: RigSpec, chains: Chains, controller: Controller, model: LoopModel) -> LoopChains:
    """The chains of all ages that a CAN bus with time leaves possible."""
    its = controller_traits(controller)
    if not isinstance(controller, GainTable | LinearFeedback | AgedFeedback) or its.sojourns or its.row_sojourns > 1:
        raise NotKnown("the theory of this controller knows no CAN bus with time")
    from hil.rig.bus_delays import bus_chains

    rows, distinguished = row_count(controller.start(model).selection, model.d_max), _distinguished(controller, model)
    sc, ca = bus_chains(rig, rows, distinguished=distinguished)
    if ca.begins is None:  # control packets travel elsewhere
        return LoopChains(*settled(*_in_phase(sc, _begins(ca, (chains.applied,)), (False, True))), "", "")
    return LoopChains(*settled(sc, ca), "", "")


def _beside_bands(rig: RigSpec, controller: Controller, distinguished: int | Sequence[int]) -> str:
    """The reason why the error of a silent node's last packet has no known bound, a phrase; empty: it has one."""
    for medium in rig.media:
        if medium.table.loss:
            return f"network.media.{medium.name}.loss loses what a node sent last"
        slots = slotted(medium, rig.sensors)
        if slots is not None and slots.waits:
            return f"network.media.{medium.name} lets others send sooner while a node is silent"
    if not isinstance(controller, GainTable | LinearFeedback):
        return "[controller] is judged over nodes that send in every slot"
    if distinguished != 1:
        return "[controller] has gains that know how old a sample is"
    return "[controller] takes several samples of a packet" if controller_traits(controller).samples > 1 else ""


def _slack(rig: RigSpec) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Bounds of the error of a silent node's last packet: absolute, and as a share of the output; empty where no node has a band.

    A node is silent while no output differs from its last packet by more than the threshold. So the controller knows every sample
    up to an error of the threshold; see `_beside_bands` for the exceptions.
    """
    from hil.rig.received_ages import BANDS

    found: dict[str, tuple[float, ...]] = {}
    for kind in BANDS:
        bands, slack = [s for s in rig.sensors if s.trigger.kind == kind], np.zeros(len(rig.outputs))
        for sensor in bands:
            slack[list(sensor.outputs)] = sensor.trigger.threshold
        found[kind] = tuple(slack.tolist()) if bands else ()
    return found["dead-band"], found["relative"]


def _distinguished(controller: Controller, model: LoopModel) -> int | Sequence[int]:
    """How many ages a controller distinguishes, of the oldest sample or of every node's."""
    if isinstance(controller, LinearFeedback):
        return 1
    if not isinstance(controller, GainTable):
        return OLDEST_DISTINGUISHED
    its = controller_traits(controller)
    if len(its.ages) > 1:
        return its.ages
    every = [np.array(K, dtype=float).reshape(len(K), -1) for K in (controller.table(model), its.state_gains) if len(K)]
    return 1 + max(int(np.flatnonzero((K[1:] != K[:-1]).any(axis=1)).max(initial=-1) + 1) for K in every)


def settled(sc: DelayChain, ca: DelayChain) -> tuple[DelayChain, DelayChain]:
    """Return both chains from the first slot on in which neither can be in a transient mode of its first slots.

    Such modes, as of a cycle that begins, add a factor to the second moments and nothing to their growth.
    """
    lead = max(0 if chain.begins is None else lasting(chain)[1] for chain in (sc, ca))
    return _later(sc, lead), _later(ca, lead)


def _later(chain: DelayChain, slots: int) -> DelayChain:
    """The chain from a slot on."""
    if chain.begins is None:
        return chain
    follows, reached = chain.bounds[1] > 0.0, np.asarray(chain.begins)
    for _ in range(slots):
        reached = follows[reached].any(axis=0)
    return within_reach(chain, reached.astype(np.float64))
