"""What a controller in C is given of its experiment: tables, and the way between its structs and cantools' codec of the DBC."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.cli.new_external import in_comment
from hil.errors import HilError
from transport.packets import SELECTIONS
from transport.wire import control_length, sensor_length

if TYPE_CHECKING:
    from hil.cli.new_external import ExternalController

NAME = "hilrig"
_QUESTION = {"Seq": "seq", "SampleTime": "stamp", "Counter": "counter", "Outputs": "outputs", "Samples": "samples",
             "References": "references", "More": "more", "Empty": "empty"}  # fmt: skip
_ANSWER = {
    "Kind": "0x32", "Selection": "SELECTION", "Tagged": "TAGGED", "Seq": "a->seq", "Echo": "a->echo", "SampleTime": "a->stamp",
    "ControlTime": "a->time", "Tau": "(int16_t)a->tau", "Rows": "ROWS", "Inputs": "INPUTS", "Counter": "a->counter",
}  # fmt: skip
_STRUCTS = """
struct question {
    uint32_t seq, counter;
    int64_t stamp;
    int outputs, samples, references, more, empty;
    float y[MOST_VALUES], r[OUTPUTS];
};
struct answer { uint32_t seq, counter; int64_t stamp, time, tau; uint64_t echo; };
"""


def c_tables(of: ExternalController, database: Any) -> str:
    """Return the header with the tables of the law, the shape of the packets, and the way to the codec's structs."""
    law, sensors, ids, step = of.law, of.sensors, of.link.identifiers, of.step
    if ids is None:
        raise HilError("a program in C needs a CAN link")
    tables, rows, inputs, width = law.gains.shape
    outputs, states = law.omega.shape[1], law.state.shape[1]
    values = [len(sensor.outputs) * sensor.buffer for sensor in sensors]
    question, answer = sensor_length(max(values) + outputs, of.keyed), control_length(rows * inputs, of.keyed)
    whole = sensors[0].outputs == tuple(range(outputs))
    most = max(*values, outputs * law.samples)
    numbers = {
        "SELECTION": SELECTIONS.index(of.loop.selection), "TAGGED": int(of.keyed), "ROWS": rows, "INPUTS": inputs,
        "OUTPUTS": outputs, "NODES": len(sensors), "Y_SIZE": outputs * law.samples, "STATES": states,
        "STATE_FIRST": int(law.state_first), "WHOLE": int(whole), "MOST_VALUES": most, "STEP": step,
        "QUESTION_SIZE": -(-question // step) * step, "ANSWER_SIZE": -(-answer // step) * step,
        "CONTROL_ID": f"{ids.control[0]:#x}", "RANGE_COUNT": len(law.ranges), "TABLES": tables,
    }  # fmt: skip
    padded = [[*sensor.outputs] + [0] * (outputs - len(sensor.outputs)) for sensor in sensors]
    arrays: list[tuple[str, str, Any]] = [
        ("int", "FIRST_ID[NODES]", [own[0] for own in ids.sensors]),
        ("int", "ID_COUNT[NODES]", [len(own) for own in ids.sensors]),
        ("int", "WAITED[NODES]", [int(sensor.trigger.kind == "every-slot") for sensor in sensors]),
        ("int", "WIDTH[NODES]", [len(sensor.outputs) for sensor in sensors]),
        ("int", "BUFFER[NODES]", [sensor.buffer for sensor in sensors]),
        ("int", "OUTPUT[NODES][OUTPUTS]", padded),
        ("int", "AGES[NODES]", list(law.ages) or [0] * len(sensors)),
        ("int", "RANGES[RANGE_COUNT][2]", [list(each) for each in law.ranges]),
        ("double", "STATE_LIMIT[STATES ? STATES : 1]", list(law.limit) or np.full(max(states, 1), np.finfo(float).max)),
        ("double", "FEEDFORWARD[INPUTS][OUTPUTS]", law.omega),
        ("double", "GAINS[TABLES][ROWS][INPUTS][STATES + Y_SIZE]", law.gains),
        ("double", "NEXT[TABLES][STATES ? STATES : 1][STATES + Y_SIZE]", law.state if states else np.zeros((tables, 1, width))),
    ]
    return "\n".join([
        f"/* The loop of {in_comment(of.loop.experiment.name)}: law, packets, and how they stand in cantools' structs.",
        " * Made by hil new. */",
        "#include <stdint.h>", "#include <string.h>", "",
        f"#define PERIOD_NS INT64_C({of.loop.experiment.period_ns})",
        *(f"#define {name} {number}" for name, number in numbers.items()), "",
        *(f"static const {kind} {name} = {_braced(value)};" for kind, name, value in arrays),
        _STRUCTS,
        *(line for n, own in enumerate(ids.sensors) for line in _unpack(database, own, n, values[n], outputs, step)),
        "static int unpack_question(int node, const uint8_t *d, struct question *q) {", "    switch (node) {",
        *(f"    case {n}: return unpack_node{n}(d, q);" for n in range(len(sensors))), "    }", "    return -1;", "}", "",
        *_pack(database, ids.control, rows, inputs, step), "",
    ])  # fmt: skip


def _braced(value: Any) -> str:
    if isinstance(value, np.ndarray | list):
        return "{" + ", ".join(map(_braced, value)) + "}"
    return repr(float(value)) if isinstance(value, float | np.floating) else str(value)


def _fragments(database: Any, own: range, step: int, bits: int) -> Iterator[tuple[int, Any]]:
    """Give the frames of a packet of so many bits: number and message."""
    for index, identifier in enumerate(own):
        if index * step * 8 >= bits:
            return
        yield index, database.get_message_by_frame_id(identifier)


def _struct(message: Any) -> str:
    from cantools.database.can.c_source import camel_to_snake_case

    return f"{NAME}_{camel_to_snake_case(message.name)}"


def _field(signal: Any) -> str:
    from cantools.database.can.c_source import camel_to_snake_case

    return camel_to_snake_case(signal.name)


def _signals(frames: Iterable[tuple[int, Any]], step: int, first: int) -> tuple[dict[str, str], dict[int, str], dict[int, str]]:
    """Return where the codec's structs hold the fields by name, the values by number, and the references of an empty packet."""
    named, values, alone = dict[str, str](), dict[int, str](), dict[int, str]()
    for index, message in frames:
        for signal in message.signals:
            place, bit = f"f{index}.{_field(signal)}", signal.start + 8 * step * index
            if bit < first:
                named[signal.name] = place
            elif signal.multiplexer_ids == [1]:
                alone[(bit - first) // 32] = place
            else:
                values[(bit - first) // 32] = place
    return named, values, alone


def _unpack(database: Any, own: range, node: int, count: int, outputs: int, step: int) -> Iterator[str]:
    frames = list(_fragments(database, own, step, 8 * sensor_length(count + outputs)))
    named, values, alone = _signals(frames, step, 256)
    yield f"static int unpack_node{node}(const uint8_t *d, struct question *q) {{"
    for index, message in frames:
        name = _struct(message)
        yield f"    struct {name}_t f{index};"
        yield f"    memset(&f{index}, 0, sizeof f{index});"
        yield f"    if ({name}_unpack(&f{index}, d + {index * step}, {step})) return -1;"
    yield from (f"    q->{own_name} = {named[signal]};" for signal, own_name in _QUESTION.items())
    yield from (f"    q->y[{i}] = {values[i]};" for i in range(count))
    for j in range(outputs):
        yield f"    q->r[{j}] = {named['Empty']} ? {alone.get(j) or values[j]} : {values[count + j]};"
    yield from ("    return 0;", "}", "")


def _pack(database: Any, own: range, rows: int, inputs: int, step: int) -> Iterator[str]:
    frames = list(_fragments(database, own, step, 8 * control_length(rows * inputs)))
    named, values, _ = _signals(frames, step, 320)
    yield "static void pack_answer(const struct answer *a, float u[ROWS][INPUTS], uint8_t *out) {"
    for index, message in frames:
        yield f"    struct {_struct(message)}_t f{index};"
        yield f"    memset(&f{index}, 0, sizeof f{index});"
    yield from (f"    {named[signal]} = {value};" for signal, value in _ANSWER.items())
    yield from (f"    {values[i]} = u[{i // inputs}][{i % inputs}];" for i in range(rows * inputs))
    yield "    memset(out, 0, ANSWER_SIZE);"
    yield from (f"    {_struct(message)}_pack(out + {index * step}, &f{index}, {step});" for index, message in frames)
    yield "}"
