"""Words of commands, and arguments of the same questions in Python, that cannot be meant: refused before anything is computed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner

import hil
from hil.cli import cli
from hil.compose import compose
from hil.errors import HilError
from hil.experiment import load_experiment

FD = "name,can_id,length,period,fd\na,1,12,10 ms,true\n"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("live", "a.mcap", "dc-motor-h2"), "a log is shown alone, and takes no script and no --foxglove"),
        (("live", "a.mcap", "--script", "b.mcap"), "a log is shown alone"),
        (("live", "dc-motor-h2", "dc-motor-hinf", "omni-push"), "3 experiments; one, or two side by side, are shown"),
        *((("live", "dc-motor-h2", "dc-motor-hinf", *more), "two experiments run side by side in virtual time") for more in (
            ("--clock", "real"), ("-o", "x.mcap"), ("--script", "b.mcap"),
        )),
        (("live", "dc-motor-h2", "--link", "can:hil:a"), "--link needs --clock real"),
        *((words, "seed: has no effect on many runs") for words in (
            ("sweep", "dc-motor-h2", "--set", "seed=3"), ("sweep", "dc-motor-h2", "--grid", "seed=1,2"),
            ("compare", "dc-motor-h2", "dc-motor-hinf", "--set", "seed = 3"),
        )),
        (("can", "analyse", "car.dbc", "--set", "period=1"), "--set: car.dbc is no experiment"),
        (("can", "analyse", "dc-motor-busy-can", "--bitrate", "500k"), "--bitrate: is for messages in a .csv or .dbc"),
        (("can", "analyse", "nosuch", "--bitrate", "500k"), "no experiment 'nosuch'"),
        (("can", "analyse", "dc-motor-busy-can", "--dbitrate", "2M"), "--bitrate: is for messages in a .csv or .dbc"),
        (("can", "analyse", "dc-motor-h2"), "dc-motor-h2: no medium of kind 'can'"),
        (("can", "analyse", "dc-motor-busy-can", "--set", 'network.media.bus.recorded=["1 123#11"]'),
         "recorded frames have no period, and no bound follows from them"),
        (("can", "analyse", "bus.log", "--bitrate", "500k"), "bus.log: recorded frames have no period"),
        (("can", "analyse", "fd.csv", "--error-interval", "1ms"), "--error-interval: only with --errors"),
        (("can", "analyse", "fd.csv", "--errors", "1", "--error-interval", "1e-10"), "1e-10 s, expected a duration from 1e-09 s"),
        (("can", "analyse", "fd.csv"), "--bitrate: missing; fd.csv says no bit rate"),
        (("can", "analyse", "fd.csv", "--bitrate", "500k"), "--dbitrate: missing; fd.csv has CAN FD messages"),
        (("can", "analyse", "fd.csv", "--bitrate", "501k", "--dbitrate", "2M"), "--bitrate: 501000"),
        (("design", "dc-motor", "--row-sojourns", "2", "--information", "tau"), "--row-sojourns: "),
        (("dbc", "--link", "can:hil:a"), "--link and --set: name an experiment"),
        (("dbc", "--set", "period=1"), "--link and --set: name an experiment"),
        (("dbc", "--c", "there", "--decode", "a.log"), "--c and --decode: one at a time"),
        (("dbc", "dc-motor-h2", "--link", "can:nosuch"), "dc-motor-h2: link 'can:nosuch'"),
        (("dbc", "dc-motor-h2", "--link", "can:hil:x?bse=0x200"), "no option is called 'bse', did you mean 'base'?"),
        (("probe", "can:hil:a", "--seconds", "1000", "--rate", "10000"), "--seconds: 10000000 frames, at most"),
        (("probe", "can:hil:a", "--answer", "--both"), "--answer: the other end measures nothing"),
        (("probe", "can:hil:a", "--answer", "-o", "x.mcap"), "--answer: the other end measures nothing"),
        (("probe", "local:", "--seconds", "1"), "link 'local:': lies within one process"),
        (("sweep", "dc-motor-h2", "--until", "sse=wide"), "--until: 'wide' is not a number; expected METRIC=HALFWIDTH"),
        (("sweep", "dc-motor-h2", "--until", "sse"), "--until 'sse': expected METRIC=HALFWIDTH, such as"),
        (("sweep", "dc-motor-h2", "--until", "ssee=1"), "--until: 'ssee' is not one of"),
        (("sweep", "dc-motor-h2", "--until", "sse=-1"), "--until: "),
        (("sweep", "dc-motor-h2", "--level", "0.9"), "--level: only with --until"),
        (("compare", "dc-motor-h2"), "compare: only 'dc-motor-h2' is named; expected two or more"),
        (("compare", "dc-motor-h2", "dc-motor-h2"), "compare: 'dc-motor-h2' is named twice"),
        (("design", "dc-motor", "--period", "0s"), "--period"),
    ],
)  # fmt: skip
def test_words_that_cannot_be_meant_are_refused(
    words: tuple[str, ...], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fd.csv").write_text(FD)
    done = CliRunner().invoke(cli, words)
    assert done.exit_code != 0 and said in (str(done.exception) if isinstance(done.exception, HilError) else done.output), done
    assert [path.name for path in tmp_path.iterdir()] == ["fd.csv"]


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (hil.compare, "compare: no experiment is named; expected two or more"),
        (lambda: hil.simulate(compose(load_experiment("dc-motor-h2")), duration="1 s"), "a composed loop takes no changes"),
        (lambda: hil.simulate(compose(load_experiment("dc-motor-h2")), **{"plant.gain": 1.0}), "a composed loop takes no"),
        (lambda: hil.sweep(load_experiment("dc-motor-h2"), grid={"plant.gain": [1.0, 2.0]}), "give its name or path"),
        (lambda: hil.sweep("dc-motor-h2", runs=0), "runs: 0, first_seed: 0; expected at least 1"),
        (lambda: hil.sweep("dc-motor-h2", first_seed=-1), "first_seed: -1"),
        (lambda: hil.sweep("dc-motor-h2", seed=3), "seed: has no effect on many runs"),
        (lambda: hil.sweep("dc-motor-h2", grid={"seed": [1, 2]}), "seed: has no effect on many runs"),
        (lambda: hil.compare("dc-motor-h2", "dc-motor-hinf", seed=3), "seed: has no effect on many runs"),
        (lambda: hil.assert_probability("dc-motor-h2", bool, at_least=0.5, seed=3), "seed: has no effect on many runs"),
        (lambda: hil.assert_probability("dc-motor-h2", bool, at_least=0.5, most_runs=0), "most_runs: 0, first_seed: 0; expected"),
        (lambda: hil.assert_probability("dc-motor-h2", bool, at_least=0.5, first_seed=-1), "first_seed: -1; expected at least"),
    ],
)  # fmt: skip
def test_arguments_that_cannot_be_meant_are_refused(ask: Callable[[], object], said: str) -> None:
    with pytest.raises(HilError) as refused:
        ask()
    assert said in str(refused.value)
