"""A loop, changed while it runs: the fields that may change, checked as those of a file, and the certificate of what then runs.

A run is a function of its experiment and of its list of changes. A change is a slot, the path of a field, and a value. The plant,
its nodes, its limits and its link stay what they are, so that the state of the run carries over.

Which changes a run in real time takes is written here alone: page, script and guide ask it.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from msgspec.structs import replace

from design.verdict import Verdict
from hil.certify import UNTIL_ALL_CAME, from_any_state
from hil.compose import check_references, compose
from hil.errors import ExperimentError, HilError
from hil.experiment import experiment_from_resolved, set_field
from hil.rig import rig_of
from hil.rig.loop import Loop, digest_of
from hil.rig.loop_chains import ANY_PHASE
from hil.rig.schedules import SCHEDULES, outlasts
from plants.parts.protocols import GoesOn, JumpPlant, Plant

ON_THE_TIME_LINE: Final = ("reference", "disturbance", "fault")
"""Tables to which a change adds an entry that begins in its slot."""

PLANT: Final = "plant."
"""What begins so is a field of the plant, where that says that it may change."""

REPLACED: Final = ("network.sc", "network.ca", "network.nodes", "controller")
"""Tables that a change replaces, whole or one field of them; of a sensor node its law."""

ROOM: Final = 10_000
"""Entries that a time line may have in the end: each is looked at when the next one comes."""

NOT_COMPARED: Final = "plant and controller are not compared with it in the run: no certificate held when the run began"
PLANT_NOT_COMPARED: Final = "the plant is not compared with its model in the run: its parameters were changed while it ran"
LAWS_NOT_COMPARED: Final = "its network laws are not compared with their chains in the run: it was changed while it ran"


def changed(loop: Loop, k: int, path: str, value: object, *, certify: bool = True) -> Loop:
    """Return the loop that runs from a slot on. Gains that were solved stay: only another controller is solved again.

    Args:
        loop: what runs until then.
        k: the first slot of the change.
        path: ``reference`` (value: the outputs' reference), ``disturbance`` (value: ``value`` and ``samples``), ``fault`` (value:
            ``kind``, ``for``, and ``link`` or ``node``), ``network.sc``, ``network.ca``, ``controller``, or a field below
            one of the last three; ``network.nodes.NAME.law``; of a plant that `GoesOn` what it lets change.
        value: as the file's parser would give it.
        certify: whether to say what can be claimed of the loop.

    Raises:
        ExperimentError: no such field, or a value that does not fit, with its path.
    """
    if path.startswith(PLANT):
        return _with_plant(loop, path, value, certify)
    table = next((name for name in (*ON_THE_TIME_LINE, *REPLACED) if path == name or path.startswith(f"{name}.")), None)
    e = loop.experiment
    if table is None or (table in ON_THE_TIME_LINE and path != table):
        raise _fixed(loop, path)
    if table.startswith("network.") and loop.rig.media:
        raise ExperimentError(e.name, [f"{path}: nodes on a shared medium keep their network; restart with --set"])
    if table == "network.nodes" and not _is_law(loop, path):
        known = " or ".join(f"network.nodes.{sensor.name}.law" for sensor in loop.rig.sensors)
        raise ExperimentError(e.name, [f"{path}: of a sensor node its law may change in a run: {known}"])
    if table in ON_THE_TIME_LINE and len(getattr(e, table)) >= ROOM:
        raise ExperimentError(e.name, [f"{path}: has {ROOM} entries; more are not taken in one run"])
    # Of a schedule the new entry alone is checked: the others were, and there may be thousands.
    raw: dict[str, Any] = copy.deepcopy((replace(e, **{table: ()}) if table in SCHEDULES else e).resolved())
    raw["allow_uncertified"] = True  # the user has seen the certificate before
    if table not in SCHEDULES and "fault" in raw:  # what is over takes no certificate away
        left = [fault.slots(float(e.period))[1] >= k or bool(outlasts(fault, loop.rig)) for fault in e.fault]
        raw["fault"] = [entry for entry, kept in zip(raw["fault"], left, strict=True) if kept]
    try:
        if table in ON_THE_TIME_LINE:
            entry = dict(value) if isinstance(value, dict) else {"value": value}
            raw[table] = [*raw.get(table, []), entry | {"at": k * float(e.period)}]
        elif path == table and isinstance(value, dict) and table != "controller":
            raw["network"][table[8:]] = {"max_age": raw["network"][table[8:]]["max_age"], **value}
        else:
            set_field(raw, path, value, f"{path} = {value!r:.60}")
        experiment = experiment_from_resolved(raw, e.text, "change", folder=e.folder)
        if table in SCHEDULES:  # none but those of a region depend on them
            rig_of(experiment)
            check_references(experiment, loop.controller, loop.model)
            kept = [entry for entry in getattr(e, table) if table != "reference" or round(entry.at / e.period) != k]
            entries = sorted([*kept, *getattr(experiment, table)], key=lambda entry: entry.at)
            verdict = loop.verdict
            if verdict is not None and verdict.kind != "passivity":
                verdict = _in_the_run(verdict)
            return dataclasses.replace(loop, experiment=replace(e, **{table: tuple(entries)}), verdict=verdict)
        knows = None if table == "controller" else loop.model
        after = compose(experiment, certify=certify, in_phase=False, knows=knows)
    except ExperimentError:
        raise
    except (HilError, TypeError, KeyError, ValueError) as error:
        raise ExperimentError(e.name, [f"{path}: {error}"]) from error
    _fits(loop, after, path)
    more = () if loop.watched is not None else (NOT_COMPARED,)
    own_laws = table.startswith("network.") and after.watched is not None and after.watched.laws
    return _assuming(after, *more, *((LAWS_NOT_COMPARED,) if own_laws else ()))


def _is_law(loop: Loop, path: str) -> bool:
    """Return whether a path is that of a sensor node's law, or of a field below it."""
    return len(loop.rig.sensors) > 1 and any(
        f"{path}.".startswith(f"network.nodes.{sensor.name}.law.") for sensor in loop.rig.sensors
    )


def _fixed(loop: Loop, path: str) -> ExperimentError:
    e = loop.experiment
    fields = e.plant.may_change() if isinstance(e.plant, GoesOn) else ()
    what = ", ".join((*ON_THE_TIME_LINE, *REPLACED, *(PLANT + name for name in fields)))
    message = f"{path}: does not change while it runs (what does: {what}); restart with --set {path}=..."
    return ExperimentError(e.name, [message])


def is_schedule(loop: Loop, path: str) -> bool:
    """Return whether a change of a field takes no new certificate: it composes at once."""
    plant = loop.experiment.plant
    return path in SCHEDULES or (isinstance(plant, GoesOn) and path in [PLANT + name for name in plant.own_way()])


def _with_plant(loop: Loop, path: str, value: object, certify: bool) -> Loop:
    """Return the loop of a plant that takes over from the one that runs."""
    e, plant = loop.experiment, loop.experiment.plant
    if not isinstance(plant, GoesOn) or not any(f"{path}.".startswith(f"{PLANT}{name}.") for name in plant.may_change()):
        raise _fixed(loop, path)
    raw: dict[str, Any] = {**copy.deepcopy(e.resolved()), "allow_uncertified": True}
    set_field(raw, path, value, f"{path} = {value!r:.60}")
    experiment = experiment_from_resolved(raw, e.text, "change", folder=e.folder)
    if isinstance(experiment.plant, GoesOn) and experiment.plant.may_change() != plant.may_change():
        raise ExperimentError(e.name, [f"{path}: {value!r:.60}: what a plant has neither begins nor ends while it runs"])
    if is_schedule(loop, path):
        before, now = plant.model(), experiment.plant.model()
        if not all(np.array_equal(getattr(before, name), getattr(now, name)) for name in "ABCD"):
            raise ExperimentError(e.name, [f"{path}: changes the plant's model, and the plant says that it does not"])
        experiment = replace(e, plant=experiment.plant)
        verdict = loop.verdict
        if verdict is not None:  # the claim is on the same equations
            verdict = replace(verdict, digest=digest_of(experiment, loop.controller, loop.model))
        return dataclasses.replace(loop, experiment=experiment, verdict=verdict).assuming(PLANT_NOT_COMPARED)
    after = compose(experiment, certify=certify, in_phase=False, knows=loop.model)
    _fits(loop, after, path)
    return _assuming(after, PLANT_NOT_COMPARED, anywhere=_some_modes(plant) or _some_modes(experiment.plant))


def _some_modes(plant: Plant) -> bool:
    """Return whether a plant jumps, and comes to some of its modes only."""
    return isinstance(plant, JumpPlant) and len(plant.jump_process().reached()[0]) < len(plant.jump_system().A)


def _assuming(loop: Loop, *more: str, anywhere: bool = False) -> Loop:
    """Add to a certificate what is not compared in a changed run; `anywhere` as of `_in_the_run`."""
    verdict = None if loop.verdict is None else _in_the_run(loop.verdict, damped=loop.rig.passivity, anywhere=anywhere)
    return dataclasses.replace(loop, verdict=verdict).assuming(*more)


def _in_the_run(verdict: Verdict, *, damped: bool = False, anywhere: bool = False) -> Verdict:
    """Return a verdict on a loop that begins in slot 0 as one on the loop from a change in its run on.

    Args:
        verdict: on the loop.
        damped: as of `from_any_state`.
        anywhere: whether a plant that jumps may be in a mode to which it does not come by itself.
    """
    found = from_any_state(verdict, damped=damped)
    if isinstance(found, str):
        why = found
    elif verdict.state == "refused" and any(said.endswith(ANY_PHASE) for said in verdict.assumptions):
        why = "which phases of what repeats meet then is not known"
    elif verdict.quantity == UNTIL_ALL_CAME:
        why = "which nodes a packet has come of by then is not known"
    elif anywhere:
        why = "in which mode the plant is then is not known"
    else:
        return found
    begun = f"{verdict.state} from slot 0 on; not decided from a change in the run on"
    return verdict.undecided(f"{begun}, as {why} ({verdict.reason})")


def _fits(before: Loop, after: Loop, path: str) -> None:
    """Refuse what the nodes of the run cannot take."""
    looks: dict[str, Callable[[Loop], object]] = {
        "samples in a sensor packet": lambda loop: (loop.samples, [s.buffer for s in loop.rig.sensors]),
        "signals of the plant": lambda loop: [s.name for s in (*loop.rig.states, *loop.rig.inputs, *loop.rig.outputs)],
        "longest delay to the controller": lambda loop: loop.model.tau_max,
        "longest delay to the actuator": lambda loop: loop.model.d_max,
        "lengths of stay with a row each": lambda loop: loop.rig.row_sojourns,
    }
    faults = [
        f"{path}: {what}: {of(after)}, and the run has {of(before)}; restart with --set {path}=..."
        for what, of in looks.items() if of(before) != of(after)
    ]  # fmt: skip
    if faults:
        raise ExperimentError(before.experiment.name, faults)


IN_REAL_TIME: Final = (*SCHEDULES, "fault", *(name for name in REPLACED if name.startswith("network.")))
"""What the rig emulates and draws; a restart of the controller among the faults kills its process and starts another.

Of the plant: what only leads it from within, by `GoesOn.own_way`.
"""

IN_ITS_PROCESS: Final = "the controller is a process of its own, which was started with its parameters"
TABULATED: Final = "the plant tabulates other equations, which may take longer than a slot"


def refuse_in_real_time(loop: Loop, path: str) -> None:
    """Refuse a change that a run in real time does not take.

    Args:
        loop: what runs.
        path: of the field, see `hil.compose.changed.changed`.

    Raises:
        ExperimentError: with the reason, and with what is taken.
    """
    plant = loop.experiment.plant
    led = tuple(PLANT + name for name in plant.own_way()) if isinstance(plant, GoesOn) else ()
    taken = (*IN_REAL_TIME, *led)
    if any(f"{path}.".startswith(f"{name}.") for name in taken):
        return
    if path.startswith("controller"):
        why = IN_ITS_PROCESS
    elif path.startswith(PLANT):
        why = TABULATED
    else:
        why = "its processes were started with it"
    message = f"{path}: does not change in real time: {why} (what does: {', '.join(taken)}); in virtual time it may"
    raise ExperimentError(loop.experiment.name, [message])
