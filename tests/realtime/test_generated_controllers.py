"""`hil new controller --language`: what it writes compiles, and drives the rig as our own controller does, bit for bit."""

from __future__ import annotations

import os
import socket
import subprocess
from pathlib import Path

import numpy as np
import pytest

from hil.cli.new_external import Language, LinkKind
from hil.compose import compose
from hil.experiment import load_experiment
from hil.files.keys import make_keys
from hil.log.read import Run
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate
from tests.foreign_session import drive
from tests.generated_controllers import asked_over, c_on_hil, generate, runs
from tests.waiting import LIMIT_S

SEED = 11
LANGUAGES = pytest.mark.parametrize("language", ["python", "c"])
EXACT = ("reference.0.at=0.2", "duration=4s")  # the motor's reference of 3.0 is a 32-bit float

CLAMPED = (
    f"controller={{kind='send-all',selection='constant',integral=true,integral_limit=[0.7],gains={[[[[-0.1, -0.01]]]] * 3}}}"
)
REMEMBERS = (
    "controller={kind='send-all',selection='constant',integral=true,integral_limit=[0.7],"
    f"gains={[[[[-0.1, -0.01, 0.1]]]] * 3},state_gains={[[[0.3 - 0.1 * tau, 0.05, 0.2]] for tau in range(3)]}}}"
)


def loop_of(name: str, *changes: str) -> Loop:
    return compose(load_experiment(name, changes), certify=False)


def assert_same_run(run: Run, own: Run) -> None:
    """Every field of what was applied and of the plant's state, bit for bit."""
    for topic in ("/actuator/applied", "/plant/state"):
        a, b = run.arrays[topic], own.arrays[topic]
        assert len(a) == len(b) > 0
        for name in a.dtype.names or ():
            np.testing.assert_array_equal(a[name], b[name], err_msg=f"{topic} {name}")


def answered(
    folder: Path, loop: Loop, language: Language, options: str = "", auth: str = "", level: str = "-O0", times: int = 1
) -> Run:
    """The run of a rig that a generated program answers over `can:hil`."""
    channel, keyed = f"gen{language}{os.getpid()}", bool(auth)
    words = generate(folder, loop, language, keyed=keyed, level=level) + ([auth] if keyed else [])
    uri = f"can:hil:{channel}{options}" + ("?" if not options else "&") * keyed + f"auth={auth}" * keyed
    with runs([*words, channel]) if language == "python" else c_on_hil(words, loop, channel, options):
        return asked_over(loop, SEED, uri, times)


@LANGUAGES
@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("dc-motor-hinf", EXACT),  # (7.36)
        ("dc-motor-ours-two-samples", EXACT),
        ("dc-motor-ours-integral", EXACT),
        ("dc-motor-hinf", (*EXACT, CLAMPED)),
        ("dc-motor-hinf", (*EXACT, REMEMBERS)),
        ("dc-motor-ours-memory", EXACT),
        ("dc-motor-ours-bursty", EXACT),  # gains by the sojourn time
        ("dc-motor-ours-stays", (*EXACT, "reference.0.value=[0.25]")),  # rows by the stay of d
        ("dc-motor-two-nodes", EXACT),  # gains by the age of each node
        ("vtol-hinf", ("duration=4s",)),
    ],
)
def test_it_applies_the_same_inputs_as_our_own(tmp_path: Path, language: Language, name: str, changes: tuple[str, ...]) -> None:
    loop = loop_of(name, *changes)
    assert_same_run(answered(tmp_path, loop, language), simulate(loop, SEED))


@LANGUAGES
def test_a_linear_controller_with_a_state_is_the_same(tmp_path: Path, language: Language) -> None:
    law = '{kind="output-feedback", A=[[0.5, 0.1], [0.0, 0.3]], B=[[0.7], [-0.2]], C=[[-0.05, 0.01]], D=[[-0.08]]}'
    loop = loop_of("dc-motor-hinf", *EXACT, f"controller={law}", "allow_uncertified=true")
    assert_same_run(answered(tmp_path, loop, language, level="-O2"), simulate(loop, SEED))


@LANGUAGES
def test_a_frame_that_comes_twice_moves_no_state_twice(tmp_path: Path, language: Language) -> None:
    loop = loop_of("dc-motor-ours-memory", *EXACT)
    assert_same_run(answered(tmp_path, loop, language, times=2), simulate(loop, SEED))


@LANGUAGES
def test_classic_frames_carry_the_same(tmp_path: Path, language: Language) -> None:
    loop = loop_of("dc-motor-two-nodes", *EXACT, "links.uri=can:hil:rig0?fd=0")
    assert_same_run(answered(tmp_path, loop, language, "?fd=0"), simulate(loop, SEED))


@LANGUAGES
def test_packets_of_several_frames_carry_the_same(tmp_path: Path, language: Language) -> None:
    gains = ", ".join(["[[[-0.1]], [[-0.05]], [[-0.04]], [[-0.03]], [[-0.02]]]"] * 3)
    law = f'{{kind="send-all", selection="applied", gains=[{gains}]}}'
    changes = (f"controller={law}", 'network.ca={law={kind="constant", age=4}, max_age=4}', "allow_uncertified=true")
    loop = loop_of("dc-motor-hinf", *EXACT, *changes, "links.uri=can:hil:rig0?fd=0&base=0x200")
    assert_same_run(answered(tmp_path, loop, language, "?fd=0&base=0x200"), simulate(loop, SEED))


@LANGUAGES
def test_with_a_key_it_is_the_same(tmp_path: Path, language: Language) -> None:
    make_keys(tmp_path / "keys")
    loop = loop_of("dc-motor-hinf", *EXACT)
    assert_same_run(answered(tmp_path, loop, language, auth=f"{tmp_path}/keys/frames.key"), simulate(loop, SEED))


@pytest.mark.parametrize("keyed", [False, True])
def test_over_zenoh_it_is_the_same(tmp_path: Path, keyed: bool) -> None:
    make_keys(tmp_path / "keys")
    key = str(tmp_path / "keys/frames.key")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
    loop = loop_of("dc-motor-hinf", *EXACT)
    words = generate(tmp_path, loop, "python", "zenoh", keyed)
    with runs([*words, *([key] if keyed else []), endpoint]):
        run = asked_over(loop, SEED, f"zenoh:{endpoint}" + (f"?auth={key}" if keyed else ""))
    assert_same_run(run, simulate(loop, SEED))


@pytest.mark.parametrize(("kind", "keyed"), [("can", True), ("zenoh", False)])
def test_without_its_arguments_a_program_says_what_they_are(tmp_path: Path, kind: LinkKind, keyed: bool) -> None:
    words = generate(tmp_path, loop_of("dc-motor-hinf"), "python", kind, keyed)
    ended = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S)
    assert ended.returncode == 1 and ended.stderr.startswith("usage: python ")


def test_the_program_in_c_says_that_its_interface_is_not_there(tmp_path: Path) -> None:
    """A name of no interface bound the socket to all of them, and a kernel without CAN was "Bad file descriptor"."""
    ended = subprocess.run([*generate(tmp_path, loop_of("dc-motor-hinf"), "c"), "vcan77"], capture_output=True, text=True)
    assert ended.returncode == 1
    assert ended.stderr in ("vcan77: No such device\n", "vcan77: Address family not supported by protocol\n")


@LANGUAGES
@pytest.mark.parametrize("name", ["multisensor-ours", "omni-push", "vtol-fault"])
def test_a_law_that_is_no_table_is_a_program_that_answers_zeros(tmp_path: Path, language: Language, name: str) -> None:
    loop = loop_of(name, "duration=0.2s") if name != "multisensor-ours" else loop_of(name, "duration=5s")
    run = answered(tmp_path, loop, language)
    applied = run.arrays["/actuator/applied"]
    assert len(applied) and all(not np.any(applied[signal.name]) for signal in loop.experiment.plant.inputs)


@pytest.mark.realtime
@pytest.mark.parametrize(("language", "keyed"), [("python", True), ("c", False)])
def test_it_drives_the_rig_in_real_time(tmp_path: Path, language: Language, keyed: bool) -> None:
    make_keys(tmp_path / "keys")
    key, channel = str(tmp_path / "keys/frames.key"), f"rt{language}{os.getpid()}"
    loop = loop_of("dc-motor-hinf")
    words = generate(tmp_path, loop, language, keyed=keyed, level="-O2") + ([key] if keyed else [])
    with runs([*words, channel], fresh=True) if language == "python" else c_on_hil(words, loop, channel):
        summary = drive(tmp_path, "dc-motor-hinf", f"can:hil:{channel}" + (f"?auth={key}" if keyed else ""))
    assert summary["link_counters"]["refused"] == 0
