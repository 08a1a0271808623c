"""Plug-ins without packaging: a file beside the experiment, and objects of Python."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import msgspec
import numpy as np
import pytest

import hil
from hil.cli import main
from hil.compose import compose
from hil.experiment import shipped
from hil.log.read import read_run
from hil.measure.view import view_of
from hil.plugins import load_own, written_in
from hil.runtime.virtual import simulate
from hil.session.replay.replay import changed_files, experiment_of
from plants import DCMotor, LinearRun, Signal, StateSpace

MODULE = '''
from __future__ import annotations
from dataclasses import dataclass
from typing import ClassVar
import numpy as np
from beside import HALF
from plants import LinearRun, Signal, StateSpace

@dataclass(frozen=True, kw_only=True)
class Cart:
    mass: float = 1.0
    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("speed", "m/s"),)
    states: ClassVar = (Signal("speed", "m/s"),)

    def model(self):
        return StateSpace(A=[[-HALF / self.mass]], B=[[1.0 / self.mass]], C=[[1.0]])

    def start(self, rng):
        return LinearRun(self.model(), (0.0,))

@dataclass(frozen=True, kw_only=True)
class Lying(Cart):
    def start(self, rng):
        return LinearRun(self.model(), (rng.standard_normal(), 2.0))

@dataclass(frozen=True, kw_only=True)
class Failing(Cart):
    def start(self, rng):
        return {}["nothing"]

@dataclass(frozen=True, kw_only=True)
class Proportional:
    gain: float = -0.3
    selection: ClassVar = "constant"
    rows_sent: int = 1

    def table(self, model):
        return np.full((model.tau_max + 1, 1, 1, 1), self.gain)

    def start(self, model):
        return self

    def rows(self, k, tau, y, r):
        return ((self.gain * (y[0] - r[0]),),) * self.rows_sent

@dataclass(frozen=True, kw_only=True)
class Half(Cart):
    def start(self, rng):
        class Running:
            state = (0.0,)
            def advance(self, dt_ns, u, w): pass
            def measure(self): return (0.0,)
        return Running()

class Whole(Half):
    def start(self, rng):
        class Running(type(Half.start(self, rng))):
            applied = (0.0,)
        return Running()

class Undisturbed(Whole):
    def start(self, rng):
        class Running(type(Whole.start(self, rng))):
            def advance(self, dt_ns, u):
                pass
        return Running()

class Seedless(Cart):
    def start(self):
        return super().start(None)

class Asserting(Cart):
    def start(self, rng):
        assert False, "at rest"

class Base(BaseException):
    pass

@dataclass(frozen=True, kw_only=True)
class Raising(Cart):
    def __post_init__(self):
        raise Base("not today")

class Meta(type):
    def __call__(cls, *arguments, **fields):
        raise Base("no instance")

@dataclass(frozen=True, kw_only=True)
class Metaclass(Cart, metaclass=Meta):
    pass

@dataclass(frozen=True, kw_only=True)
class Leaving(Cart):
    @property
    def inputs(self):
        raise SystemExit(0)

class NoDataclass:
    pass

def fastest(view):
    """The highest speed."""
    return float(np.abs(view.tracking()[1]).max())
'''
OWN: dict[str, Any] = {"plant": {"kind": "cart:Cart"}, "duration": 2, "limits.state": {}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "cart.py").write_text(MODULE)
    (tmp_path / "beside.py").write_text("HALF = 0.5\n")
    (tmp_path / "exp.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    return tmp_path


def test_a_class_beside_the_experiment_is_a_plant_a_controller_and_a_metric(folder: Path) -> None:
    changes = OWN | {"controller": {"kind": "cart:Proportional"}, "report.measures": ["tracking", "cart:fastest"]}
    session = hil.run(folder / "exp.toml", log=folder / "a.mcap", **changes)
    assert session.summary["certificate"]["state"] == "certified"  # judged like ours: by the one door
    assert session.metrics["fastest"] == np.abs(session.arrays["/plant/measurement"]["speed"]).max()
    run = read_run(folder / "a.mcap")
    assert run.resolved["plant"] == {"kind": "cart:Cart", "mass": 1.0}
    assert run.metadata["plant"].startswith("cart:Cart of cart.py, SHA-256 ")
    with pytest.raises(hil.HilError, match=r"a\.mcap: its plant was cart:Cart, .*; its controller .* --folder DIR"):
        hil.verify(folder / "a.mcap")
    assert hil.verify(folder / "a.mcap", folder=folder).difference is None
    known = view_of(run).experiment  # a log runs no module; what it says of the rest is known all the same
    assert known is not None and known.network.sc.max_age == 2 and known.report.measures == ("tracking",)


def test_a_module_that_was_changed_is_reported(folder: Path) -> None:
    hil.run(folder / "exp.toml", log=folder / "a.mcap", **OWN)
    (folder / "cart.py").write_text(MODULE.replace("1.0 / self.mass", "2.0 / self.mass"))
    run = read_run(folder / "a.mcap")
    assert "ran; now it is cart:Cart of cart.py" in changed_files(run, experiment_of(run, "a", folder=str(folder)))[0]
    assert hil.verify(folder / "a.mcap", folder=folder).difference is not None


def test_another_process_finds_the_file_before_the_class(folder: Path) -> None:
    cart = load_own("cart:Cart", folder)(mass=2.0)
    reported = f"import pickle; print(pickle.loads({pickle.dumps(cart)!r}).model().B.tolist())"
    assert subprocess.run([sys.executable, "-c", reported], capture_output=True, text=True, check=True).stdout == "[[0.5]]\n"
    assert written_in(type(cart)) is not None and written_in(DCMotor) is None


def test_a_text_that_two_folders_hold_is_found_where_it_was_read_last(tmp_path: Path) -> None:
    text = "from dataclasses import dataclass\n@dataclass\nclass Twice:\n    mass: float\n"
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "twice.py").write_text(text)
        twice = load_own("twice:Twice", tmp_path / name)
    (tmp_path / "one" / "twice.py").write_text(f"{text}# changed since\n")
    reported = f"import pickle; print(pickle.loads({pickle.dumps(twice(mass=2.0))!r}).mass)"
    done = subprocess.run([sys.executable, "-c", reported], capture_output=True, text=True)
    assert done.stdout == "2.0\n", done.stderr


@pytest.mark.parametrize(
    ("plant", "reported"),
    [
        ("kart:Cart", r"plant\.kind: 'kart:Cart': there is no kart\.py in .*"),
        ("cart:Car", r"has no 'Car'; it has Asserting, Base, Cart, Failing, Half, Leaving, Lying, "),
        ("cart:NoDataclass", r"plant\.kind: 'cart:NoDataclass' is no dataclass"),
        ("cart:Proportional", r"plant: 'cart:Proportional': check_plant: Proportional, a plant, needs `inputs` \(.*`outputs`"),
        ("cart:Lying", r"plant: 'cart:Lying': check_plant: "),
        ("cart:Failing", r"check_plant: KeyError: 'nothing' \(.*cart\.py, line \d+\)"),
        ("cart:Half", r"check_plant: what Half\.start\(rng\) returns needs `applied` \(the input that was commanded last"),
        ("cart:Whole", r"what Whole\.start\(rng\) returns: advance\(dt_ns, u, w=\(\)\) must work with and without w: missing"),
        ("cart:Undisturbed", r"returns: advance\(dt_ns, u, w=\(\)\) must work with and without w: too many positional arguments"),
        ("cart:Seedless", r"check_plant: Seedless\.start\(rng\): too many positional arguments"),
        ("cart:Raising", r"plant: 'cart:Raising': Base: not today \(.*cart\.py, line \d+\)"),
        ("cart:Metaclass", r"plant: 'cart:Metaclass': Base: no instance \(.*cart\.py, line \d+\)"),
        ("cart:Asserting", r"check_plant: AssertionError: at rest \(.*cart\.py, line \d+\)"),
        ("cart:Leaving", r"plant: 'cart:Leaving': check_plant: .*SystemExit: 0 \(.*cart\.py, line \d+\)"),
        ("raising:Cart", r"raising\.py, line 2: Base: at the door"),
        ("broken:Cart", r"broken\.py, line 2: ZeroDivisionError: division by zero"),
        ("wordy:Cart", r"wordy\.py, line 1: SyntaxError: "),
        ("leaving:Cart", r"leaving\.py, line 1: SystemExit: 3"),
        ("mute:Cart", r"mute\.py, line 3: Mute: \(its __str__ raises ZeroDivisionError\)"),
        ("../cart:Cart", r"plant\.kind: '\.\./cart:Cart': expected module:Class"),
    ],
)
def test_what_is_no_plant_is_refused_in_a_sentence(folder: Path, plant: str, reported: str) -> None:
    (folder / "broken.py").write_text("x = 1\n1 / 0\n")
    (folder / "raising.py").write_text("class Base(BaseException): pass\nraise Base('at the door')\n")
    (folder / "wordy.py").write_text("this is no Python\n")
    (folder / "leaving.py").write_text("raise SystemExit(3)\n")
    (folder / "mute.py").write_text("class Mute(Exception):\n    def __str__(self): return 1 / 0\nraise Mute\n")
    with pytest.raises(hil.HilError, match=reported):
        hil.load_experiment(folder / "exp.toml", **OWN | {"plant": {"kind": plant}})


def test_a_controller_that_answers_wrongly_is_refused_before_slot_0(folder: Path) -> None:
    changes = OWN | {"controller": {"kind": "cart:Proportional", "rows_sent": 2}}
    with pytest.raises(hil.HilError, match=r"controller\.kind: check_controller: 2 rows, expected 1"):
        compose(hil.load_experiment(folder / "exp.toml", **changes))


class Cart:
    """No dataclass: as the cell of a notebook would write it."""

    inputs: ClassVar = (Signal("force", "N"),)
    outputs: ClassVar = (Signal("speed", "m/s"),)
    states: ClassVar = (Signal("speed", "m/s"),)

    def __init__(self, mass: float) -> None:
        self.mass = mass

    def model(self) -> StateSpace:
        return StateSpace(A=[[-1.0 / self.mass]], B=[[1.0 / self.mass]], C=[[1.0]])

    def start(self, rng: np.random.Generator) -> LinearRun:
        return LinearRun(self.model(), (0.0,))


@dataclass(frozen=True, kw_only=True)
class Law:
    gain: float = -0.3
    selection: ClassVar = "constant"

    def start(self, model: object) -> Law:
        return self

    def rows(self, k: int, tau: int, y: tuple[float, ...], r: tuple[float, ...]) -> tuple[tuple[float, ...], ...]:
        return ((self.gain * (y[0] - r[0]),),)


def test_objects_are_named_in_the_log_and_taken_again(tmp_path: Path) -> None:
    changes: dict[str, Any] = {"limits.state": {}, "duration": 2, "allow_uncertified": True}
    log = tmp_path / "a.mcap"
    session = hil.run("dc-motor-hinf", plant=Cart(2.0), controller=Law(gain=-0.2), log=log, **changes)
    run = read_run(log)
    assert run.metadata["plant"] == f"object {Cart.__module__}.Cart (not in the experiment file)"
    assert run.resolved["controller"] == {"kind": f"object {Law.__module__}.Law", "gain": -0.2}
    assert "<svg" in session._repr_html_() and session.metrics["sse"] > 0
    with pytest.raises(hil.HilError, match=r"was object .*Cart, .* hil\.verify\('.*', plant=\.\.\., controller=\.\.\.\)"):
        hil.verify(log)
    assert hil.verify(log, plant=Cart(2.0), controller=Law(gain=-0.2)).difference is None
    assert hil.verify(log, plant=Cart(2.1), controller=Law(gain=-0.2)).difference is not None


@pytest.mark.parametrize("given", [{"plant": Cart(2.0)}, {"controller": Law()}])
def test_a_page_is_made_of_a_log_whose_objects_no_file_holds(tmp_path: Path, given: dict[str, Any]) -> None:
    log = tmp_path / "a.mcap"
    hil.run("dc-motor-hinf", log=log, **given, **{"limits.state": {}, "duration": 2, "allow_uncertified": True})
    figures = ["--figures", tmp_path] if "plant" in given else []  # a second for their fonts
    for command in (["report", log, *figures], ["export", log, "-o", tmp_path / "a.npz"], ["layout", "foxglove", log]):
        with pytest.raises(SystemExit) as end:
            main([*map(str, command)])
        assert not end.value.code, command
    page = log.with_suffix(".html").read_text()
    assert all(f"object {type(part).__module__}.{type(part).__name__}" in page for part in given.values())


def test_an_object_of_an_installed_plugin_is_what_its_table_would_make() -> None:
    experiment = hil.load_experiment("dc-motor-hinf", duration=1)
    run = hil.simulate(experiment, plant=DCMotor(gain=160.0))
    same = hil.simulate("dc-motor-hinf", duration=1, **{"plant.gain": 160})
    assert (run.arrays["/plant/state"] == same.arrays["/plant/state"]).all()
    assert hil.load_experiment("dc-motor-hinf", plant=DCMotor(gain=160.0)).resolved()["plant"]["kind"] == "dc-motor"


def test_a_plant_that_was_replaced_is_never_logged_as_the_one_of_the_file() -> None:
    replaced = msgspec.structs.replace(hil.load_experiment("dc-motor-hinf"), plant=Cart(1.0))
    assert replaced.resolved()["plant"] == {"kind": f"object {Cart.__module__}.Cart"}


def test_what_is_no_plant_and_no_controller_says_what_it_lacks() -> None:
    with pytest.raises(hil.HilError, match=r"plant: builtins\.int: .*int, a plant, needs `inputs`.*\n.*.*needs `start`"):
        hil.run(hil.load_experiment("dc-motor-hinf"), plant=3, controller=object())
    wide = type("Wide", (Law,), {"samples": "two"})()
    with pytest.raises(hil.HilError, match=r"check_controller: samples: 'two', expected a whole number above 0"):
        hil.run(hil.load_experiment("dc-motor-hinf"), controller=wide)
    with pytest.raises(hil.HilError, match="takes no changes but a plant and a controller"):
        hil.run(hil.load_experiment("dc-motor-hinf"), **{"plant.gain": 3})
    simulate(compose(hil.load_experiment("dc-motor-hinf", duration=1, controller=Law(), allow_uncertified=True)), 0)


WRONG = '''
from dataclasses import dataclass
from cart import Cart, Proportional
from plants import StateSpace

@dataclass(frozen=True, kw_only=True)
class Named(Cart):
    inputs = ("force",)

@dataclass(frozen=True, kw_only=True)
class Number(Cart):
    outputs = 3

@dataclass(frozen=True, kw_only=True)
class NoModel(Cart):
    def model(self): return None

@dataclass(frozen=True, kw_only=True)
class Flat(Proportional):
    def table(self, model): return [[1.0]]

@dataclass(frozen=True, kw_only=True)
class NoTable(Proportional):
    def table(self, model): return None

@dataclass(frozen=True, kw_only=True)
class Alone(Proportional):
    def table(self): return 0

@dataclass(frozen=True, kw_only=True)
class Leaves(Proportional):
    def table(self, model): raise SystemExit("not today")

class Mute(AssertionError):
    def __str__(self): return 1 / 0

@dataclass(frozen=True, kw_only=True)
class Silent(Proportional):
    def table(self, model): raise Mute
'''


@pytest.mark.parametrize(
    ("path", "kind", "reported"),
    [
        ("plant", "Named", r"check_plant: Named\.inputs: \('force',\), expected a tuple of plants\.Signal"),
        ("plant", "Number", r"check_plant: Number\.outputs: 3, expected a tuple of plants\.Signal"),
        ("plant", "NoModel", r"check_plant: NoModel\.model\(\): None, expected a plants\.StateSpace"),
        ("controller", "Flat", r"check_controller: table\(model\) of shape \(1, 1\), expected \(tau, 1, 1, 1\), tau up to 2"),
        ("controller", "NoTable", r"check_controller: table\(model\) of shape \(\), expected"),
        ("controller", "Alone", r"check_controller: table\(model\): TypeError: .*Alone\.table\(\) takes 1 positional"),
        ("controller", "Silent", r"table\(model\): Mute: \(its __str__ raises ZeroDivisionError\) \(.*wrong\.py, line \d+\)"),
        ("controller", "Leaves", r"check_controller: table\(model\): SystemExit: not today \(.*wrong\.py, line \d+\)"),
    ],
)
def test_a_typical_mistake_is_reported_in_its_author_s_words(folder: Path, path: str, kind: str, reported: str) -> None:
    (folder / "wrong.py").write_text(WRONG)
    with pytest.raises(hil.HilError, match=reported) as said:
        hil.run(folder / "exp.toml", log=folder / "a.mcap", **OWN | {path: {"kind": f"wrong:{kind}"}})
    assert "AttributeError" not in str(said.value) and not (folder / "a.mcap").exists()


@pytest.mark.parametrize("length", [300, 5_000, 500_000])
def test_a_module_of_a_name_that_no_file_can_have_is_refused(length: int) -> None:
    with pytest.raises(hil.HilError, match=r"there is no m+\.py in"):
        load_own("m" * length + ":Cart", ".")
