"""Which signals of a DBC the values of a rig are, as a link's URI says it; what cannot be used so is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from tests.links.test_own_messages import DBC, ONE
from transport.links import TransportError
from transport.links.message_table import Place, names_of, read_table
from transport.links.opening import open_link
from transport.links.traits import traits_of


def refused(dbc: Path = DBC, **options: str) -> str:
    with pytest.raises(ValueError) as caught:
        read_table({"dbc": str(dbc), **ONE, **options})
    return str(caught.value)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"outputs": "Encodr.Angle"}, "outputs: no message is called 'Encodr', did you mean 'Encoder'?"),
        ({"outputs": "Encoder.Angel"}, "outputs: no signal of Encoder is called 'Angel', did you mean 'Angle'?"),
        ({"outputs": "Encoder"}, "outputs: no signal of Encoder is called '', expected one of Angle, Alive, Temperature, Torque"),
        ({"outputs": ","}, "outputs, inputs: expected MESSAGE.SIGNAL of one output at least, and of every input"),
        ({"inputs": "Brake.Force,"}, "outputs, inputs: expected MESSAGE.SIGNAL of one output at least, and of every input"),
        ({"outputs": "Encoder.Angle:rad"}, "outputs: Encoder.Angle is in 'deg', the rig's value in 'rad'; say the factor: "
         "Encoder.Angle*57.29577951308232"),
        ({"inputs": "DriveCommand.Voltage:mV"}, "inputs: DriveCommand.Voltage is in 'V', the rig's value in 'mV'; say the "
         "factor: DriveCommand.Voltage*0.001"),
        ({"outputs": "Encoder.Temperature:rad"}, "outputs: Encoder.Temperature is in 'degC', the rig's value in 'rad'; say the "
         "factor: Encoder.Temperature*FACTOR"),
        ({"outputs": "Encoder.Angle*0"}, "outputs: Encoder.Angle*0: expected a factor, as in Encoder.Angle*57.3"),
        ({"outputs": "Encoder.Angle*nan"}, "outputs: Encoder.Angle*nan: expected a factor, as in Encoder.Angle*57.3"),
        ({"outputs": "Encoder.Angle,Encoder.Angle"}, "outputs: Encoder.Angle: is, or its message is, among the outputs already"),
        ({"inputs": "Encoder.Torque"}, "inputs: Encoder.Torque: is, or its message is, among the outputs already"),
        ({"counters": "DriveCommand.Field"}, "counters: DriveCommand.Field: is, or its message is, among the inputs already"),
        ({"inputs": "Switched.One"}, "inputs: message Switched is multiplexed, expected one whose signals all have a place of "
         "their own"),
        ({"valid": "61"}, "valid: '61', expected seconds up to 60"),
        ({"valid": "nan"}, "valid: 'nan', expected seconds up to 60"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_so_is_refused_with_its_name(options: dict[str, str], said: str) -> None:
    assert refused(**options) == said


@pytest.mark.parametrize("unit", ["N m", "Nm", "N*m", "nm", ""])
def test_one_unit_in_other_letters_is_one_unit(unit: str) -> None:
    assert read_table({"dbc": str(DBC), **ONE, "outputs": f"Encoder.Torque:{unit}"}).outputs[0][0].scale == 1


@pytest.mark.parametrize(("real", "number", "value"), [(False, 3, 0.3), (False, -3, -0.3), (False, 4, None), (False, -4, None),
                                                       (True, 2.9, 0.29), (True, 3.1, None), (True, -3.1, None)])  # fmt: skip
def test_the_limits_of_a_signal_are_decimals_and_a_command_beyond_them_is_none(
    real: bool, number: float, value: float | None
) -> None:
    place = Place(key=1, signal="Force", scale=2.0, factor=0.1, offset=0.0, low=-0.3, high=0.3, real=real)
    received = place.received(number)
    assert math.isnan(received) if value is None else received == pytest.approx(value / 2)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("Angle : 0|16@1-", "Angle : 56|16@1-", "outputs: message Encoder: The signal Angle does not fit in message Encoder."),
        ("Angle : 0|16@1-", "Angle : 10|16@1-", "outputs: message Encoder: The signals Alive and Angle are overlapping in "
         "message Encoder."),
    ],
)  # fmt: skip
def test_a_message_of_which_no_frame_can_be_made_is_refused(tmp_path: Path, old: str, new: str, said: str) -> None:
    path = tmp_path / "car.dbc"
    path.write_text(DBC.read_text().replace(old, new))
    assert refused(path) == said
    assert read_table({"dbc": str(path), **ONE, "outputs": "Setpoint.Wanted"}).measured == {386}, "the others may be used"


def test_a_signal_of_one_value_and_a_file_that_is_no_dbc_are_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.dbc"
    other.write_text(DBC.read_text().replace("Which M", "Which").replace("One m0", "One"))
    assert refused(other, outputs="Switched.Nothing").startswith("outputs: signal Nothing: factor 0, offset 0, expected finite")
    other.unlink()
    assert refused(other) == f"dbc: {other}: a DBC cannot be read: No such file or directory"
    other.write_text("BO_ 1 X: 99999999 Y\n")
    assert refused(other).startswith(f"dbc: {other}: is no DBC: ")
    other.write_text("what")
    assert refused(other).startswith(f"dbc: {other}: is no DBC: ")


@pytest.mark.parametrize(
    ("options", "role", "said"),
    [
        ("", "controller", "dbc: its other end is your own controller, with its own messages; start it, and the rig by hil rig"),
        ("&base=0x200", "rig", "base: says how the rig's own packets travel; with dbc= none do"),
        ("&nodes=2", "rig", "nodes: says how the rig's own packets travel; with dbc= none do"),
        ("&auth=frames.key", "rig", "auth: messages of the controller's own (dbc=) have no room for a code"),
    ],
)
def test_what_cannot_stand_beside_them_is_refused(options: str, role: Any, said: str) -> None:
    uri = f"can:hil:bench?dbc={DBC}&outputs=Encoder.Angle&inputs=DriveCommand.Voltage{options}"
    with pytest.raises(TransportError) as caught:
        traits_of(uri) if "auth" in options else open_link(uri, role)
    assert str(caught.value) == f"link {uri!r}: {said}"


def test_the_options_are_read_without_a_database() -> None:
    assert names_of({}) == [[], [], [], []]
    assert names_of({"outputs": "a.b;c.d,e.f", "counters": "g.h"}) == [["a.b"], ["c.d", "e.f"], [], [], ["g.h"]]
