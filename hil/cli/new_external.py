"""``hil new controller --language``: a controller as a program of its own, for the rig of any experiment.

The law of a controller stands in it as tables that any language can run: which gains belong to which age, and how its state
goes on.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from typing import Any, Final, Literal

import numpy as np
from msgspec import Struct

from design.controllers import GainTable, LinearFeedback, controller_traits, feedforward
from design.controllers.gain_rows import sojourn_ranges
from hil.errors import HilError
from hil.rig.loop import Array, Loop
from hil.rig.sensors import Sensor
from hil.rig.session_link import SessionLink, link_of, rig_dbc
from transport.links.traits import framing_options, with_options
from transport.packets import SELECTIONS
from transport.wire import MAX_VALUES

Language = Literal["python", "c"]
LinkKind = Literal["can", "zenoh"]
HERE: Final = {"can": "can:hil:rig0", "zenoh": "zenoh:tcp/127.0.0.1:7447"}


class ExternalController(Struct, frozen=True, kw_only=True):
    """What a foreign program needs to know of a loop.

    Args:
        loop: composed.
        law: the tables of its controller.
        link: of the program, with the identifiers of its frames.
        kind: of the link.
        keyed: whether every packet has a message authentication code.
        argument: the experiment, as the command line names it.
        options: of the rig's link, which the program takes for granted.
    """

    loop: Loop
    law: LawTables
    link: SessionLink
    kind: LinkKind
    keyed: bool
    argument: str
    options: Mapping[str, str]

    def rig_link(self, uri: str) -> str:
        """Return the link of the rig beside the program, as a shell takes it.

        Args:
            uri: where both meet, without options.
        """
        return quote(in_comment(with_options(uri, self.options)))

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The sensor nodes, by number."""
        return self.loop.rig.sensors

    @property
    def step(self) -> int:
        """Bytes that one CAN frame carries."""
        return 64 if self.link.traits.can is None else self.link.traits.can.frame_bytes


def external_controller(loop: Loop, argument: str, kind: LinkKind, keyed: bool) -> ExternalController:
    """Return what a program needs to know.

    Args:
        loop: composed.
        argument: the experiment, as the command line names it.
        kind: of the link; the experiment's own link counts where it is of this kind.
        keyed: whether every packet has a message authentication code.

    Raises:
        HilError: more values than a packet carries.
    """
    rig, law = loop.rig, law_tables(loop)
    own = rig.links.uri
    uri = own if own.startswith(f"{kind}:") and kind == "can" and "auth=" not in own else HERE[kind]
    key = {"auth": "KEYFILE"} if keyed else {}  # the file is not read: only its place in the packet counts
    link = link_of(rig, with_options(uri, key))
    _, rows, inputs, _ = law.gains.shape
    if rows * inputs > MAX_VALUES:
        raise HilError(f"controller: {rows} rows of {inputs} inputs, a packet carries {MAX_VALUES} values")
    if kind == "can" and link.identifiers is None:
        raise HilError("network.nodes: more nodes than a CAN link has identifiers for; use --link zenoh")
    return ExternalController(loop=loop, law=law, link=link, kind=kind, keyed=keyed, argument=argument,
                              options=framing_options(uri) | key)  # fmt: skip


def program_files(of: ExternalController, stem: str, language: Language) -> dict[str, str]:
    """Return name and text of every file of the program.

    Args:
        of: what it needs to know.
        stem: its name.
        language: C is for CAN links.

    Raises:
        HilError: C over zenoh.
    """
    if language == "python":
        return {f"{stem}.py": _filled("external_controller.py.txt", of, _python_values(of, stem))}
    if of.kind != "can":
        raise HilError("--link zenoh: a program in C needs zenoh-pico, which is not generated for; use --link can, or python")
    from hil.cli.can import c_codec, database_of
    from hil.cli.new_external_c import c_tables

    values = _words(of, stem, "KEYFILE " * of.keyed + "INTERFACE|-", "can:socketcan:INTERFACE") | {
        "SHA256_H": ", ".join(f"0x{_root_bits(p, 2):08x}u" for p in PRIMES[:8]),
        "SHA256_K": ", ".join(f"0x{_root_bits(p, 3):08x}u" for p in PRIMES),
        "CMAC_TOO": ", AES-128 and its CMAC" if of.keyed else "",
    }
    database = database_of(rig_dbc(of.loop.rig, of.link.uri))
    header, codec = c_codec(database)
    return {
        f"{stem}.c": _filled("external_controller.c.txt", of, values),
        f"{stem}.h": c_tables(of, database),
        "packet_codes.h": _filled("packet_codes.h.txt", of, values),
        "hilrig.h": header,
        "hilrig.c": codec,
    }


def in_comment(text: str) -> str:
    """Return a text as it may stand in a comment of C and in a docstring, so that no text of an experiment becomes code.

    >>> in_comment("it's */ import os")
    'it_s _/ import os'
    """
    return "".join(c if c.isprintable() and c not in "\"'\\*" else "_" for c in text)


def _words(of: ExternalController, stem: str, usage: str, uri: str) -> dict[str, Any]:
    e = of.loop.experiment
    return {
        "CONTROLLER": f"'{in_comment(e.kinds.get('controller', '?'))}'", "EXPERIMENT": in_comment(e.name),
        "ARGUMENT": quote(in_comment(of.argument)), "STEM": stem,
        "FILE": f"{stem}.py", "USAGE": usage, "LINK": of.rig_link(uri),
        "WHY": in_comment(of.law.why_none), "FIRST": 2 if of.keyed else 1,
    }  # fmt: skip


def _python_values(of: ExternalController, stem: str) -> dict[str, Any]:
    law, loop, sensors, ids = of.law, of.loop, of.sensors, of.link.identifiers
    usage = {"can": "CHANNEL [INTERFACE]", "zenoh": "ENDPOINT [NAME]"}[of.kind]
    selection = SELECTIONS.index(loop.selection)
    values = _words(of, stem, "KEYFILE " * of.keyed + usage, HERE[of.kind])
    return values | {
        "PERIOD_NS": loop.experiment.period_ns, "SELECTION": selection, "SELECTION_NAME": loop.selection,
        "ROWS": law.gains.shape[1], "INPUTS": law.gains.shape[2], "OUTPUTS": law.omega.shape[1], "SAMPLES": law.samples,
        "NODES": tuple(sensor.outputs for sensor in sensors), "BUFFERS": tuple(sensor.buffer for sensor in sensors),
        "WAITED": tuple(sensor.trigger.kind == "every-slot" for sensor in sensors),
        "STEP": of.step, "FD": of.step == 64, "SENSORS": ids and ids.sensors, "CONTROL": ids and ids.control,
        "AGES": law.ages, "RANGES": law.ranges, "FEEDFORWARD": law.omega.tolist(), "GAINS": law.gains.tolist(),
        "NEXT": law.state.tolist(), "STATE_FIRST": law.state_first,
        "STATE_LIMIT": law.limit,
        "TAGGED_FLAG": "| TAGGED" if of.keyed else "", "KEY": "key" if of.keyed else "",
    }  # fmt: skip


def _filled(template: str, of: ExternalController, values: dict[str, Any]) -> str:
    """Return a template with its names filled in, and of its conditional blocks those that hold."""
    from importlib import resources

    text = (Path(str(resources.files("hil") / "templates")) / template).read_text(encoding="utf-8")
    holds = {"keyed": of.keyed, "plain": not of.keyed, "known": not of.law.why_none, "unknown": bool(of.law.why_none),
             "can": of.kind == "can", "zenoh": of.kind == "zenoh"}  # fmt: skip
    lines, nested = list[str](), list[bool]()
    for line in text.splitlines():
        mark = re.fullmatch(r"\s*(?:#|//)\? (\w+)", line)
        if mark is None:
            if all(nested):
                lines.append(line)
        elif mark[1] == "end":
            nested.pop()
        else:
            nested.append(holds[mark[1]])
    return re.sub(r" *@([A-Z0-9_]+)@", lambda name: _placed(name, values), "\n".join(lines)) + "\n"


def _placed(name: re.Match[str], values: dict[str, Any]) -> str:
    value = str(values[name[1]])
    return name[0][: name[0].index("@")] + value if value else ""


PRIMES: Final = tuple(n for n in range(2, 312) if all(n % divisor for divisor in range(2, n)))
"""The first 64."""


def _root_bits(prime: int, degree: int) -> int:
    """Return the first 32 bits behind the point of the root of a prime: the constants of SHA-256 (FIPS 180-4).

    A double has 50 bits behind the point of these roots, and no root of `PRIMES` lies within its rounding of a border.

    >>> hex(_root_bits(2, 2)), hex(_root_bits(2, 3))
    ('0x6a09e667', '0x428a2f98')
    """
    return int(prime ** (1 / degree) % 1 * 2**32)


class LawTables(Struct, frozen=True, kw_only=True, eq=False):
    """u_row = Omega r + K[table, row] z, xi' = F[table] z; z are the errors y - r of the newest samples, and the state xi.

    Args:
        omega: feedforward, (m, p).
        gains: K, (tables, rows, m, width).
        state: F, (tables, state, width).
        state_first: z is (xi, e), else (e, xi): sums are rounded in this order.
        samples: samples of every output in e.
        ages: of each sensor node how many ages have tables of their own; empty where the oldest age has the table.
        ranges: of each age the first and the last of its tables, for 1, 2, ... slots at this age; the last entry for all beyond.
        limit: largest size of every entry of the state; empty: any.
        why_none: why the tables hold zeros; empty where they are the controller's.
    """

    omega: Array
    gains: Array
    state: Array
    state_first: bool
    samples: int
    ages: tuple[int, ...]
    ranges: tuple[tuple[int, int], ...]
    limit: tuple[float, ...] = ()
    why_none: str = ""


def law_tables(loop: Loop) -> LawTables:
    """Return the tables of a loop's controller; zeros, and why, of one that states neither gains nor matrices."""
    controller, model = loop.controller, loop.model
    m, p = model.B.shape[1], model.C.shape[0]
    its = controller_traits(controller)
    if isinstance(controller, GainTable):
        K = np.asarray(controller.table(model), dtype=float)
        sojourns = (1,) * len(K) if isinstance(its.sojourns, int) or not its.sojourns else tuple(its.sojourns)
        sums = p * its.integrates
        moves = np.zeros((len(K), sums + its.order, K.shape[-1]))
        moves[:, :sums] = np.eye(sums, K.shape[-1]) + np.eye(sums, K.shape[-1], p * its.samples)  # of the newest errors
        if its.state_gains:
            moves[:, sums:] = its.state_gains
        limit = (*its.integral_limit, *its.order * [sys.float_info.max]) if its.integral_limit else ()
        return LawTables(
            omega=feedforward(model), gains=K, state=moves, state_first=False, samples=its.samples,
            ages=its.ages if len(its.ages) > 1 else (), ranges=tuple(sojourn_ranges(sojourns)), limit=limit,
        )  # fmt: skip
    if isinstance(controller, LinearFeedback):
        law = controller.linear_law(model)
        return LawTables(
            omega=feedforward(model), gains=np.hstack([law.C, law.D])[None, None], state=np.hstack([law.A, law.B])[None],
            state_first=True, samples=1, ages=(), ranges=((0, 0),),
        )  # fmt: skip
    return LawTables(
        omega=np.zeros((m, p)), gains=np.zeros((1, loop.rows, m, p * loop.samples)), state=np.zeros((1, 0, p * loop.samples)),
        state_first=False, samples=loop.samples, ages=(), ranges=((0, 0),),
        why_none=f"the controller {loop.experiment.kinds.get('controller', '?')!r} is no table of gains alone",
    )  # fmt: skip
