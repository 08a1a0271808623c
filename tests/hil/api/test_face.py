"""The face: what `import hil` gives, what it costs, and that it does what the command line does."""

from __future__ import annotations

import pickle
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import design
import hil
import plants
import transport
from design import controllers
from hil.compose import compose
from plants import LinearPlant
from plants.parts.linear_run import LinearRun
from plants.parts.protocols import PlantRun

ROOT = Path(__file__).parents[3]
OURS = {"plants", "transport", "design"}
HEAVY = OURS | {"numpy", "scipy", "msgspec", "rich", "mcap", "control", "cvxpy", "cantools", "can", "zenoh"}


def all_imported_by(code: str, **options: Any) -> set[str]:
    """Return every module that a fresh interpreter has imported after some code."""
    show = "; import sys; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", code + show], capture_output=True, text=True, check=True, timeout=300, **options)
    return set(done.stdout.splitlines()[-1].split())


def imported_by(code: str) -> set[str]:
    """Return the top-level modules, and the rooms of hil, that a fresh interpreter has imported after some code."""
    return {".".join(m.split(".")[: 2 if m.startswith("hil") else 1]) for m in all_imported_by(code)}


def test_importing_the_face_imports_nothing_else() -> None:
    found = imported_by("import hil")
    assert not found & HEAVY and {m for m in found if m.startswith("hil.")} == set()


def test_the_help_of_the_command_line_imports_nothing_heavy() -> None:
    code = "from hil.cli import main\ntry: main(['--help'])\nexcept SystemExit: pass\n"
    found = imported_by(code + "import click")
    assert "click" in found and not found & HEAVY


UNUSED = {
    "scipy", "rich", "can", "zenoh", "control", "cvxpy", "pandas", "numpy.ma", "mcap.writer", "cryptography", "loky", "pydantic",
    "plants.vtol", "plants.omni", "plants.fmu", "plants.state_space", "plants.semi_markov", "design.controllers.smith",
    "design.controllers.historical", "design.controllers.wall", "design.controllers.virtual_wall", "hil.log.read",
    "hil.api.face", "transport.laws.packet", "transport.links.authentication", "design.tracking.synthesis",
}  # fmt: skip


def test_a_run_imports_its_own_plant_and_controller_and_nothing_that_it_does_not_use(tmp_path: Path) -> None:
    run = "['run', 'dc-motor-hinf', '--duration', '0.1', '-o', 'x.mcap', '--set', 'reference=[]', '--set', 'disturbance=[]']"
    found = all_imported_by(f"from hil.cli import main\ntry: main({run})\nexcept SystemExit: pass\nimport os", cwd=tmp_path)
    assert {"plants.dc_motor", "design.controllers.send_all", "transport.laws.age"} <= found
    assert (tmp_path / "x.mcap").stat().st_size and not sorted(found & UNUSED)


def test_a_report_of_a_usual_run_imports_no_scipy(tmp_path: Path) -> None:
    """It would take a third of its time; the run is long enough for its law to be tested."""
    done = hil.run("dc-motor-hinf", log=tmp_path / "x.mcap")
    found = imported_by(f"import hil; hil.report({str(tmp_path / 'x.mcap')!r})")
    assert "hil.pages" in found and "scipy" not in found
    assert 0.0 < done.summary["network"]["sc"]["p_value"] < 1.0


@pytest.mark.parametrize("package", [hil, design, controllers, plants, transport])
def test_every_name_of_a_face_is_there(package: object) -> None:
    names = package.__all__  # type: ignore[attr-defined]
    assert names and all(getattr(package, name) is not None for name in names)
    assert set(names) <= set(dir(package))


def test_no_name_of_the_face_is_also_a_module_of_ours() -> None:
    modules = {path.stem for path in Path(hil.__file__).parent.iterdir()}
    assert not modules & set(hil.__all__), "importing such a module would put it in the name's place"


@pytest.mark.slow
def test_a_type_checker_knows_what_the_faces_return(tmp_path: Path) -> None:
    """The installed packages, as their py.typed lets it; from the cache of mypy where it has run here: a tenth of the time."""
    if (ROOT / ".mypy_cache").is_dir():
        shutil.copytree(ROOT / ".mypy_cache", tmp_path / "known")
    (tmp_path / "user.py").write_text(
        "import design, hil, plants, transport\n"
        "reveal_type(hil.run('x').metrics)\nreveal_type(design.h2_norm)\nreveal_type(plants.DCMotor())\n"
        "reveal_type(transport.MarkovAge)\nhil.run(3)\nhil.rum('x')\n"
        "reveal_type((hil.sweep('x', runs=2, duration=1), hil.sweep('x', grid={}), hil.sweep('x', range={}, points=2)))\n"
    )
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", "known", "user.py"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    told = done.stdout
    for part in ("dict[str, Any]", "-> float", "plants.dc_motor.DCMotor", "transport.laws.age.MarkovAge"):
        assert part in told, told
    assert "tuple[hil.sweeps.Sweep, hil.sweeps.parameters.ParameterSweep, hil.sweeps.parameters.ParameterSweep]" in told, told
    assert 'Argument 1 to "run"' in told and 'Module has no attribute "rum"' in told, told


def test_run_does_what_the_command_does_and_keeps_no_log_unless_asked(tmp_path: Path) -> None:
    session = hil.run("dc-motor-hinf", seed=3, duration=2, **{"plant.gain": 150})
    assert session.status == 0 and session.summary["log"]["path"] is None and session.summary["units"]["sse"] == "rad² s"
    kept = hil.run(hil.load_experiment("dc-motor-hinf", ["plant.gain=150"], duration="2 s"), seed=3, log=tmp_path / "a.mcap")
    assert kept.summary["log"]["sha256"] == session.summary["log"]["sha256"]
    assert hil.read_run(tmp_path / "a.mcap").resolved["plant"]["gain"] == 150
    again = hil.simulate("dc-motor-hinf", seed=3, duration=2, **{"plant.gain": np.float64(150)})
    np.testing.assert_array_equal(again.arrays["/plant/state"], session.arrays["/plant/state"])
    with pytest.raises(hil.HilError, match="exists already"):
        hil.run("dc-motor-hinf", duration=1, log=tmp_path / "a.mcap")


def test_a_log_that_another_run_wrote_meanwhile_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both looked before they composed their loops, and the quicker one has ended."""
    path = tmp_path / "a.mcap"

    def slowly(*asked: Any, **options: Any) -> Any:
        path.write_text("of the other run")
        return compose(*asked, **options)

    monkeypatch.setattr("hil.session.compose", slowly)
    with pytest.raises(hil.HilError, match=r"a\.mcap: cannot be created: another run has written it meanwhile"):
        hil.run("dc-motor-local", duration=0.2, log=path)
    assert path.read_text() == "of the other run"
    hil.run("dc-motor-local", duration=0.2, log=path, force=True)
    assert path.read_bytes().startswith(b"\x89MCAP")


def test_changes_of_every_kind_reach_the_experiment() -> None:
    changed = hil.load_experiment(
        "dc-motor-hinf", allow_uncertified=True, description='say "it"\n',
        **{"network.sc.law": {"kind": "iid", "probabilities": np.array([0.5, 0.5])}, "reference.0.value": (2,)},
    )  # fmt: skip
    assert changed.allow_uncertified and changed.description == 'say "it"\n' and changed.reference[0].value == (2.0,)
    assert changed.kinds["network.sc.law"] == "iid"


def test_what_cannot_be_is_reported_as_one_error() -> None:
    loaded = hil.load_experiment("dc-motor-hinf", duration=1)
    for call in (
        lambda: hil.run("dc-motor-hinf", sed=3),
        lambda: hil.run("dc-motor-hinf", **{"plant.gain": object()}),
        lambda: hil.run(loaded, duration=2),
        lambda: hil.run(loaded, link="memory:"),
        lambda: hil.sweep(loaded, runs=0),
        lambda: hil.compare(loaded, loaded),
        lambda: hil.compare(loaded),
        lambda: hil.compare(loaded, "dc-motor-h2", runs=1),
        lambda: hil.design("dc-motor", objektive="h2"),
    ):
        with pytest.raises(hil.HilError):
            call()


def test_a_result_may_leave_its_process_and_be_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    found = [hil.run("dc-motor-hinf", duration=1), hil.run("dc-motor-hinf", duration=1, log="a.mcap")]
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    for session in found:
        copy = pickle.loads(pickle.dumps(session))
        np.testing.assert_array_equal(copy.arrays["/plant/state"], session.arrays["/plant/state"])
        assert copy.summary == session.summary and repr(copy) == repr(session)
        assert session != copy and session.run != copy.run and session in {session}
    many, same = (hil.sweep("dc-motor-hinf", runs=2, jobs=1, duration=1) for _ in range(2))
    assert many != same and {many: 1}[many]


def test_a_session_is_one_line() -> None:
    said = repr(hil.run("dc-motor-hinf", duration=1))
    assert said == "<Session dc-motor-hinf seed 0, virtual time, 20 slots, squared tracking error 0 rad² s>"


def test_sweep_compare_and_design_give_numbers() -> None:
    assert hil.sweep("dc-motor-hinf", runs=3, jobs=1, duration=2).values["sse"].shape == (3,)
    compared = hil.compare("dc-motor-hinf", "dc-motor-h2", runs=3, jobs=1, duration=4)
    gap = compared.difference("dc-motor-h2", "sse")
    mine, theirs = (compared.values[name]["sse"] for name in ("dc-motor-h2", "dc-motor-hinf"))
    assert gap.n == 3 and gap.value == pytest.approx(np.mean(mine - theirs))
    assert hil.design("dc-motor", information="constant", starts=1).certificate.stable


def test_a_log_is_verified_with_the_models_that_it_was_run_with(tmp_path: Path) -> None:
    import control  # a second of CPU time, and matplotlib's list of fonts in the home

    motor = control.tf([150.0], [1.0, 12.0, 0.0])
    gain = [[0.05]]
    changes = {"limits.state": {}, "reference.0.at": 0.25, "allow_uncertified": True}
    hil.run("dc-motor-hinf", plant=motor, controller=gain, duration=1, log=tmp_path / "a.mcap", **changes)
    assert hil.verify(tmp_path / "a.mcap", plant=motor, controller=gain).difference is None
    other = hil.verify(tmp_path / "a.mcap", plant=control.tf([140.0], [1.0, 12.0, 0.0])).difference
    assert other is not None and "/plant/measurement" in str(other)
    with pytest.raises(hil.HilError, match=r"plant: builtins\.int: .*a plant, needs `inputs`"):
        hil.verify(tmp_path / "a.mcap", plant=3)


class Pushed(LinearPlant):
    """Begins somewhere else than its fields say."""

    def start(self, rng: np.random.Generator) -> PlantRun:
        return LinearRun(self.model(), (1.0,))


def test_a_class_in_place_of_its_object_is_called_so() -> None:
    with pytest.raises(hil.HilError, match=r"plant: the class Pushed, expected an object of it: plant=Pushed\(\)"):
        hil.run("dc-motor-hinf", plant=Pushed)


def test_gains_are_designed_for_an_object_in_an_experiment() -> None:
    motor = hil.load_experiment("dc-motor-hinf", plant=plants.DCMotor(gain=100.0))
    found = hil.design(motor, information="constant", starts=1)
    same = hil.design("dc-motor-hinf", information="constant", starts=1)
    assert found.certificate.stable and not np.array_equal(found.problem.B, same.problem.B)


def test_a_subclass_of_a_shipped_plant_runs_by_its_own_methods() -> None:
    changes = {"limits.state": {}, "allow_uncertified": True, "controller": 0.0}
    fields: dict[str, Any] = {"A": ((-1.0,),), "B": ((1.0,),), "C": ((1.0,),)}
    said = hil.simulate("dc-motor-hinf", plant=LinearPlant(**fields), duration=1, **changes)
    own = hil.simulate("dc-motor-hinf", plant=Pushed(**fields), duration=1, **changes)
    assert said.arrays["/plant/state"]["x1"][0] == 0.0 and own.arrays["/plant/state"]["x1"][0] == 1.0


@pytest.mark.parametrize(("link", "said"), [("can:hill:x", "did you mean 'hil'"), ("can:hil:x?timd=1", "did you mean 'timed'")])
def test_a_link_that_cannot_be_opened_is_said_in_its_own_words(link: str, said: str) -> None:
    """In a notebook nobody sees what a process of the run writes on standard error."""
    with pytest.raises(hil.HilError, match=rf"^link '{re.escape(link)}': .*{said}"):
        hil.run("dc-motor-hinf", clock="real", link=link, duration=1)
