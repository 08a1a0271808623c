"""Experiment files: what is accepted, and that every fault is named by its path, all at once, with nothing left behind."""

from __future__ import annotations

import json
import subprocess
import tomllib
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import SimpleNamespace

import pytest

from hil.compose import compose
from hil.errors import ExperimentError, HilError
from hil.experiment import (
    Seconds,
    experiment_from_resolved,
    load_experiment,
    parse_experiment,
    parse_plugin,
    parse_table,
    shipped,
)
from hil.experiment.schema import experiment_schema
from hil.experiment.table import UnavailablePlugin, plain
from hil.plugins import registry
from hil.rig.named_files import with_law_files
from tests.warm_hil import hil_command
from transport.laws.age import ConstantAge
from transport.laws.latency import latency
from transport.laws.packet import PacketLaw
from transport.laws.trace import TraceAge

GOOD = shipped()["dc-motor-hinf"].read_text().replace("[limits]", '[links]\nuri = "can:hil:rig0"\n\n[limits]')
MARKOV = 'sc.law = { kind = "markov", matrix = [[0.6, 0.4, 0.0], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]] }'


def changed(old: str, new: str) -> str:
    assert old in GOOD
    return GOOD.replace(old, new)


def law(text: str) -> str:
    return changed(MARKOV, f"sc.law = {text}")


def test_a_log_in_place_of_an_experiment_is_called_so(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.write_bytes(b"\x89MCAP0\r\n" + bytes(2_000_000))
    with pytest.raises(HilError, match=r"run\.mcap: is a log, expected an experiment; `hil report`"):
        load_experiment(str(log))


FAULTS: list[tuple[str, str, str]] = [
    # id, text, what the message must hold
    ("wrong type of period", changed('period = "50 ms"', "period = [1]"), "period: "),
    ("unknown unit", changed('"50 ms"', '"3 parsecs"'), "period: '3 parsecs' is not a duration"),
    ("negative period", changed('"50 ms"', "-0.05"), "period: -0.05 s is not between"),
    ("zero period", changed('"50 ms"', "0"), "period: 0 s is not between"),
    ("period that is NaN", changed('"50 ms"', "nan"), "period: nan is not a finite number"),
    ("infinite duration", changed('"50 s"', "inf"), "duration: inf is not a finite number"),
    ("duration below a period", changed('"50 s"', '"1 ms"'), "duration: 0.001 s is shorter"),
    ("duration without end", changed('"50 s"', '"100000000 h"'), "duration: 7.2e+12 slots"),
    ("no period", changed('period = "50 ms"\n', ""), "period: missing"),
    ("no name", changed('name = "dc-motor-hinf"\n', ""), "name: missing"),
    ("name with a path", changed('name = "dc-motor-hinf"', 'name = "../x"'), "name: '../x'"),
    ("seed that is text", changed("seed = 0", 'seed = "zero"'), "seed: expected a whole number, got text 'zero'"),
    ("negative seed", changed("seed = 0", "seed = -1"), "seed: -1 is not between"),
    ("unknown key", changed("seed = 0", "sed = 0"), "sed: unknown field; did you mean 'seed'?"),
    ("reserved key", changed("seed = 0", 'text = "x"'), "text: unknown field"),
    ("unknown table", GOOD + "\n[plants]\nx = 1\n", "plants: unknown field"),
    ("unknown plant", changed('kind = "dc-motor"', 'kind = "dc-moter"'), "did you mean 'dc-motor'?"),
    ("plant without kind", changed('kind = "dc-motor"', "gain = 1.0"), "plant.kind: missing; one of"),
    ("no plant", changed('[plant]\nkind = "dc-motor"\n', ""), "plant: missing table"),
    ("plant that is a number", changed('[plant]\nkind = "dc-motor"\n', "").replace("seed = 0", "seed = 0\nplant = 3"),
     "plant: expected a table, got 3"),
    ("parameter of the wrong type", changed('kind = "dc-motor"', 'kind = "dc-motor"\ngain = "big"'),
     "plant.gain: expected a number, got text 'big'"),
    ("parameter out of range", changed('kind = "dc-motor"', 'kind = "dc-motor"\ngain = -1.0'), "plant.gain: "),
    ("unknown parameter", changed('kind = "dc-motor"', 'kind = "dc-motor"\ngian = 1.0'), "did you mean 'gain'?"),
    ("nested parameter out of range",
     changed('kind = "dc-motor"', 'kind = "dc-motor"\n[plant.friction]\nstatic_v = -0.1'), "plant.friction.static_v"),
    ("unknown controller", changed('kind = "hinf"', 'kind = "magic"'), "controller.kind: no controller plug-in"),
    ("gains of another shape", changed('kind = "hinf"', 'kind = "send-all"\ngains = [[[[1.0]]]]'), "controller.gains: shape"),
    ("gains that are ragged", changed('kind = "hinf"', 'kind = "send-all"\ngains = [[[[1.0]], [[1.0, 2.0]]]]'),
     "controller.gains: expected [tau][row][m][p]"),
    ("gain that is text", changed('kind = "hinf"', 'kind = "local"\ngain = [["x"]]'), "controller.gain[0][0]: expected a number"),
    ("row that sums to 0.98", law('{ kind = "markov", matrix = [[0.6, 0.4], [0.5, 0.48]] }'),
     "network.sc.law.matrix[1]: row sums to 0.98"),
    ("negative probability", law('{ kind = "markov", matrix = [[1.2, -0.2], [0.5, 0.5]] }'), "network.sc.law.matrix[0]"),
    ("probability that is NaN", law('{ kind = "markov", matrix = [[nan, 1.0], [0.5, 0.5]] }'),
     "network.sc.law.matrix[0][0]: nan is not a finite number"),
    ("matrix that is not square", law('{ kind = "markov", matrix = [[1.0], [0.5, 0.5]] }'), "network.sc.law.matrix"),
    ("empty matrix", law('{ kind = "markov", matrix = [] }'), "network.sc.law.matrix"),
    ("age that grows by two", law('{ kind = "markov", matrix = [[0.5, 0.3, 0.2], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]] }'),
     "network.sc.law.matrix[0][2]"),
    ("unknown initial law", law('{ kind = "markov", matrix = [[0.5, 0.5], [0.7, 0.3]], initial = "foo" }'),
     "network.sc.law.initial: invalid enum value 'foo', expected one of stationary, uniform"),
    ("three samples per packet", changed('kind = "hinf"', 'kind = "designed"\nsamples = 3'),
     "controller.samples: invalid enum value 3, expected one of 1, 2"),
    ("unknown affinity", GOOD + '\n[timing]\naffinity = "cpu0"\n', "expected one of auto, free, pinned, shared"),
    ("unknown law", law('{ kind = "poisson" }'), "network.sc.law.kind: no law plug-in"),
    ("negative age", law('{ kind = "constant", age = -1 }'), "network.sc.law.age"),
    ("delay beyond every packet", law('{ kind = "constant", age = 64 }'), "network.sc.law: its largest delay 64 is above 63"),
    ("unknown link", changed("can:hil:rig0", "nonsense"), "links.uri: link 'nonsense': no scheme"),
    ("link of an unknown scheme", changed("can:hil:rig0", "cam:hil:rig0"), "did you mean 'can:hil:rig0'?"),
    ("link without a channel", changed("can:hil:rig0", "can:hil"), "links.uri: link 'can:hil': no channel"),
    ("link without an endpoint", changed("can:hil:rig0", "zenoh:127.0.0.1:7447"), "as in tcp/127.0.0.1:7447"),
    ("delay bound above the rows", law('{ kind = "constant", age = 4 }'), "controller.kind: the published gains cover"),
    ("rows below the law's delay", changed("[limits]", "[network.ca]\nmax_age = 0\n[limits]").replace(
        "ca.law = ", "#").replace("[network.ca]", '[network.ca]\nlaw = { kind = "constant", age = 1 }'),
     "network.ca.max_age: 0 is below the law's largest delay 1"),
    ("no network", GOOD.split("[network]")[0], "network: missing table"),
    ("link without a law", changed(MARKOV, ""), "network.sc: missing table"),
    ("law that cannot be certified",
     law('{ kind = "packet", latency = { dist = "expon", scale = "1 ms" } }\nsc.max_age = 2'),
     "allow_uncertified"),
    ("reference of the wrong width", changed("value = [3.0]", "value = [3.0, 1.0]"), "reference[0].value: length 2, expected 1"),
    ("reference in the past", changed('at = "1 s"', 'at = "-1 s"'), "reference[0].at: -1 s is negative"),
    ("disturbance without samples", changed("samples = 2", "samples = 0"), "disturbance[0].samples: 0 is below 1"),
    ("disturbance of the wrong width", changed("value = [0.1]", "value = []"), "disturbance[0].value: length 0, expected 1"),
    ("limit of an unknown state", changed("angle = 20.0", "angel = 20.0"), "limits.state.angel: the plant has no such state"),
    ("node of 42 letters", GOOD + f"\n[network.nodes.{'a' * 42}]\noutputs = ['angle']", "a: expected a letter and up to 40"),
    ("limits that are no list", changed("input = [5.0]", "input = true"), "limits.input: expected a list or nothing, got true; "
                                                                          "it is written [number, ...]"),
    ("limit that is zero", changed("input = [5.0]", "input = [0.0]"), "limits.input[0]: 0 is not positive"),
    ("limits of the wrong width", changed("input = [5.0]", "input = [5.0, 5.0]"), "limits.input: length 2, expected 1"),
    ("watchdog of zero slots", GOOD + "watchdog_slots = 0\n", "limits.watchdog_slots: 0 is below 1"),
    ("deadline beyond the period", GOOD + "[timing]\ndeadline = 1.5\n", "timing.deadline: 1.5"),
    ("priority out of range", GOOD + "[timing]\npriority = 99\n", "timing.priority: 99"),
    ("unknown overrun policy", GOOD + '[timing]\noverrun = "skip"\n', "timing.overrun: "),
    ("loop that is not stable", changed('kind = "hinf"', 'kind = "local"'), "radius 1.054"),
    ("not TOML", "name = \n", "not valid TOML"),
    ("no quotes", "name = 'a'\nperiod = 50 ms\n", "'period = 50 ms'; text and durations stand in quotes"),
    ("a key twice", GOOD.replace("seed = 0", "seed = 0\nseed = 1"), "not valid TOML"),
    ("instant that is no number", GOOD + '\n[[reference]]\nat = "nan s"\nvalue = [1.0]\n',
     "at: 'nan s' is not a duration"),
    ("instant beyond a double", GOOD + '\n[[disturbance]]\nat = "1e400 s"\nsamples = 1\nvalue = [1.0]\n',
     "is not a finite number"),
    ("instant beyond the clock", GOOD + "\n[[disturbance]]\nat = 1e308\nsamples = 1\nvalue = [1.0]\n",
     "1e+308 s is above 6e+09 s"),
    ("safe state without end", GOOD + "\n[limits]\nafter_trip = 1e308\n" if "[limits]" not in GOOD
     else changed("[limits]", "[limits]\nafter_trip = 1e308"), "limits.after_trip: 1e+308 s is above 6e+09 s"),
    ("integer of 5001 digits", changed("seed = 0", "seed = " + "9" * 5001), "a number has more than 400 digits"),
    ("integer beyond a double", changed('kind = "dc-motor"', 'kind = "dc-motor"\ngain = 1' + "0" * 350),
     "plant.gain: an integer of"),
    ("number whose products leave a double", changed('kind = "dc-motor"', 'kind = "dc-motor"\ngain = -1.1e30'),
     "plant.gain: -1.1e+30 is beyond 1e+30"),
    ("number whose square is 0", changed('kind = "dc-motor"', 'kind = "dc-motor"\npole = 1e-101'),
     "plant.pole: 1e-101 is below 1e-100 and not 0"),
    ("nested too deeply", "a = " + "[" * 5000 + "]" * 5000, "nested too deeply"),
    ("dotted too deeply", ".".join(["a"] * 4000) + " = 1", "nested too deeply"),
    ("empty", "", "period: missing"),
]


@pytest.mark.parametrize(("text", "expected"), [pytest.param(t, e, id=i) for i, t, e in FAULTS])
def test_fault_is_named_by_its_path(text: str, expected: str) -> None:
    with pytest.raises(HilError) as caught:
        compose(parse_experiment(text))
    lines = str(caught.value).splitlines()
    assert any(expected in line for line in lines), lines
    assert all(len(line) < 400 for line in lines)


def test_all_faults_are_reported_at_once() -> None:
    text = changed('"50 ms"', "-1").replace("seed = 0", 'seed = "x"').replace("samples = 2", "samples = 0")
    text = text.replace("0.6, 0.4, 0.0", "0.6, 0.3, 0.0").replace('kind = "dc-motor"', 'kind = "dc-motor"\ngain = "g"')
    with pytest.raises(ExperimentError) as caught:
        parse_experiment(text)
    paths = {fault.split(": ")[0] for fault in caught.value.faults}
    assert {"period", "seed", "disturbance[0].samples", "network.sc.law.matrix[0]", "plant.gain"} <= paths


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 40, b"[" * 10_000_000], ids=["binary", "10 MB"])
def test_hil_run_refuses_garbage_with_status_2_and_leaves_nothing(tmp_path: Path, data: bytes) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_bytes(data)
    done = hil_command("run", str(bad), cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("hil: ") and len(done.stderr.splitlines()) == 1
    assert done.stdout == "" and [p.name for p in tmp_path.iterdir()] == ["bad.toml"]


def test_hil_run_refuses_a_faulty_file_with_every_path_and_leaves_nothing(tmp_path: Path) -> None:
    bad = tmp_path / "bad.toml"
    bad.write_text(changed('"50 ms"', "-1").replace("seed = 0", "seed = 1.5"))
    done = hil_command("run", "bad.toml", cwd=tmp_path)
    assert done.returncode == 2
    assert {line.split(": ")[2] for line in done.stderr.splitlines()} == {"period", "seed"}
    assert [p.name for p in tmp_path.iterdir()] == ["bad.toml"]


SHOWN_TO_BE_REFUSED = ("omni-theorem61",)


@pytest.mark.parametrize("name", sorted(shipped()))
def test_the_resolved_form_of_a_shipped_experiment_is_the_same_experiment(name: str) -> None:
    experiment = load_experiment(name)
    assert experiment.name == name and experiment.description
    resolved = json.loads(json.dumps(experiment.resolved()))
    assert experiment_from_resolved(resolved, experiment.text, name).resolved() == experiment.resolved()


LONG_DESIGNS = {"dc-motor-ours-hinf", "dc-motor-ours-integral", "dc-motor-ours-mixed"}
LONG_CERTIFICATES = {"vtol-delayed-published"}
CERTIFIED_ELSEWHERE = {
    "dc-motor-h2-friction", "dc-motor-hinf-friction", "dc-motor-hinf-supply",  # tests/hil/certify/test_region.py
    "smjls-robust", "vtol-delayed", "vtol-fault",  # tests/hil/test_rigs.py
}  # fmt: skip
LONG = LONG_DESIGNS | LONG_CERTIFICATES | CERTIFIED_ELSEWHERE


@pytest.mark.parametrize("name", sorted(LONG_CERTIFICATES))
def test_shipped_experiment_whose_certificate_takes_long_composes_without_it(name: str) -> None:
    assert compose(load_experiment(name), certify=False).verdict is None


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] * (n in LONG)) for n in sorted(shipped())])
def test_shipped_experiment_composes(name: str) -> None:
    experiment = load_experiment(name)
    if name in SHOWN_TO_BE_REFUSED:
        with pytest.raises(ExperimentError, match="refused: "):
            compose(experiment)
        experiment = load_experiment(name, ["allow_uncertified=true"])
    compose(experiment)


@pytest.mark.parametrize(
    ("law_text", "heading"),
    [
        ('{ kind = "trace", file = "x.csv" }', "age\n0\n1\n"),
        ('{ kind = "packet", latency = { file = "x.csv" } }\nsc.max_age = 2', "1 ms\n"),
    ],
    ids=["ages", "latencies"],
)
def test_a_recorded_law_is_read_from_beside_the_experiment(law_text: str, heading: str, tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text(law(law_text))
    with pytest.raises(ExperimentError, match=r"network\.sc\.law\.(latency\.)?file: .*x\.csv: No such file"):
        load_experiment(tmp_path / "x.toml")
    (tmp_path / "x.csv").write_text(heading)
    assert "file" not in str(load_experiment(tmp_path / "x.toml").network.sc.law).replace("file=''", "")
    (tmp_path / "x.csv").unlink()
    (tmp_path / "x.csv").symlink_to("/dev/zero")
    with pytest.raises(ExperimentError, match=r"x\.csv is no regular file"):
        load_experiment(tmp_path / "x.toml")


def test_what_is_not_finite_is_said_once() -> None:
    with pytest.raises(ExperimentError) as caught:
        parse_experiment(law('{ kind = "markov", matrix = [[nan, 1.0], [0.5, 0.5]] }'))
    assert caught.value.faults == ["network.sc.law.matrix[0][0]: nan is not a finite number"]


def test_a_file_of_a_change_is_that_of_the_working_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a shipped experiment it was looked for among the shipped files alone."""
    (tmp_path / "law.toml").write_text("kind = 'constant'\nage = 1\n")
    monkeypatch.chdir(tmp_path)
    experiment = with_law_files(load_experiment("dc-motor-hinf", ["network.sc.law={file='law.toml'}"]))
    assert experiment.network.sc.law == ConstantAge(age=1)
    (tmp_path / "car.csv").write_text("name,can_id,length,period\n")
    change = "network.media.bus={kind='can', bitrate=500000, nodes=['motor'], control=true, traffic_file='car.csv'}"
    bus = load_experiment("dc-motor-busy-can", [change]).network.media["bus"]
    assert bus.traffic_file == str(tmp_path / "car.csv")


def test_a_key_of_a_law_from_a_file_can_be_changed(tmp_path: Path) -> None:
    """A sweep over the loss of a measured law ended with `network.sc.law.kind: missing`."""
    (tmp_path / "law.toml").write_text("kind = 'packet'\nlatency = '3 ms'\nloss = 0.1\n[fit]\npackets = 2000\n")
    (tmp_path / "x.toml").write_text(law('{ file = "law.toml" }\nsc.max_age = 2'))
    changed = load_experiment(tmp_path / "x.toml", ["network.sc.law.loss=0.25"]).network.sc.law
    assert changed == PacketLaw(latency="3 ms", loss=0.25)
    with pytest.raises(ExperimentError, match=r"network\.sc\.law\.los: unknown field"):
        load_experiment(tmp_path / "x.toml", ["network.sc.law.los=0.25"])


def test_files_may_begin_with_the_mark_of_utf_8(tmp_path: Path) -> None:
    """Editors and spreadsheets of Windows write it: such a file was "not valid TOML", such a head an entry."""
    (tmp_path / "x.toml").write_text("\ufeff" + law('{ file = "law.toml" }'))
    (tmp_path / "law.toml").write_text("\ufeffkind = 'trace'\nfile = 'ages.csv'\npast_end = 'repeat'\n")
    (tmp_path / "ages.csv").write_text("\ufeffage\n0\n1\n")
    law_that_runs = with_law_files(load_experiment(tmp_path / "x.toml")).network.sc.law
    assert isinstance(law_that_runs, TraceAge) and law_that_runs.ages == (0, 1)


def test_set_changes_fields_tables_and_list_entries() -> None:
    e = load_experiment("dc-motor-hinf", ["plant.gain=100", "reference.0.value=[1.0]", "links.uri=memory:", "period=10 ms"])
    assert (e.plant.gain, e.reference[0].value, e.links.uri, e.period) == (100.0, (1.0,), "memory:", 0.01)


@pytest.mark.parametrize("change", ["plant.gain", "=3", "reference.7.at=1", "seed.x=1", "plant..gain=1"])
def test_set_that_makes_no_sense_is_refused(change: str) -> None:
    with pytest.raises(HilError, match="--set"):
        load_experiment("dc-motor-hinf", [change])


def test_schema_takes_what_every_shipped_file_has_and_asks_for_no_more() -> None:
    schema = experiment_schema()
    tables = schema["$defs"]
    for name, path in shipped().items():
        raw = tomllib.loads(path.read_text())
        sides = [(tables["Direction"], raw["network"][side]) for side in ("sc", "ca")]
        for table, given in ((schema, raw), (tables["Network"], raw["network"]), *sides):
            assert set(table["required"]) <= given.keys() <= table["properties"].keys(), name
    kinds = {variant["properties"]["kind"].get("const") for variant in schema["properties"]["plant"]["oneOf"]}
    assert {"dc-motor", "vtol"} <= kinds
    json.dumps(schema)


def test_schema_explains_every_key() -> None:
    schema = experiment_schema()
    tables = [schema, *schema["$defs"].values()]
    keys = [(table["title"], name, key) for table in tables for name, key in table.get("properties", {}).items()]
    assert len(keys) > 100
    tags = [name for _, name, key in keys if len(key.get("enum", ())) == 1]
    assert [(title, name) for title, name, key in keys if not key.get("description") and name not in tags] == []


def test_schema_has_no_key_that_a_file_may_not_set() -> None:
    assert "selection" not in experiment_schema()["$defs"]["Local"]["properties"]


def test_the_schema_that_the_experiments_name_lies_beside_them() -> None:
    path = shipped()["dc-motor-hinf"].with_name("experiment.schema.json")
    assert "#:schema ./experiment.schema.json" in GOOD
    if not path.is_file():
        pytest.skip("this checkout was not installed since it was checked out: uv pip install --reinstall -e . writes the schema")
    made = json.loads(path.read_text())  # by the build; after a change of a key it is that of the last build
    assert made["$id"] == "hilrig-experiment" and "Experiment" not in made["$defs"]


def test_the_build_writes_the_schema_that_hil_prints(tmp_path: Path) -> None:
    """With the entry points of pyproject.toml, while nothing is installed."""
    root = Path(__file__).parents[3]
    spec = spec_from_file_location("hatch_build", root / "hatch_build.py")
    assert spec is not None and spec.loader is not None
    hook = module_from_spec(spec)
    spec.loader.exec_module(hook)
    project = tomllib.loads((root / "pyproject.toml").read_text())["project"]
    (tmp_path / hook.SCHEMA).parent.mkdir(parents=True)
    hook.write_schema(tmp_path, project["entry-points"])
    assert json.loads((tmp_path / hook.SCHEMA).read_text()) == json.loads(json.dumps(experiment_schema()))
    ignored = subprocess.run(["git", "check-ignore", "-q", str(root / hook.SCHEMA)], cwd=root)
    assert ignored.returncode in (0, 128), "the schema is made, not kept"


@pytest.mark.parametrize("written", ["25ms", "25 ms", " 0.025s ", "25000us", ".025", "2.5e-2 s", 0.025])
def test_a_duration_has_a_space_before_its_unit_or_none(written: object) -> None:
    assert Seconds.parse(written) == pytest.approx(0.025, rel=1e-12)


def test_durations_are_read_alike_wherever_they_stand() -> None:
    fault = '\n[[fault]]\nat = "3s"\nfor = "500ms"\nkind = "cut"\nlink = "sc"\n'
    for text in (GOOD + fault, (GOOD + fault).replace("50 ms", "50ms").replace("50 s", "50s")):
        found = parse_experiment(text, sets=["limits.after_trip=1500ms"])
        assert (found.fault[0].at, found.fault[0].lasts, found.limits.after_trip) == (3.0, 0.5, 1.5)
    assert load_experiment("dc-motor-hinf", ["period=25ms"], duration="2min").period_ns == 25_000_000
    assert latency("12ms") == latency("12 ms") == latency(0.012)
    parse_plugin("hil.laws", "packet", ["latency=12ms"])


@pytest.mark.parametrize(
    ("value", "said"),
    [(float("inf"), "not a finite number"), (1e300, "is beyond"), (1e-300, "is below"), (1 << 70, "an integer of 71 bits")],
)
def test_a_table_alone_is_read_as_in_a_file_and_holds_no_number_that_none_holds(value: float, said: str) -> None:
    with pytest.raises(HilError, match=rf"^plant\.gain: .*{said}"):
        parse_table("hil.plants", {"kind": "dc-motor", "gain": value}, "plant")


def test_a_field_with_a_wrong_value_is_not_also_missing() -> None:
    fault = '\n[[fault]]\nat = "3 s"\nfor = "3 parsecs"\nkind = "cut"\nlink = "sc"\n'
    with pytest.raises(ExperimentError) as reported:
        parse_experiment(GOOD + fault)
    assert reported.value.faults == [
        "fault[0].for: '3 parsecs' is not a duration: expected a number and one of s, ms, us, ns, min, h, as in 25ms or 1.5 h"
    ]


def test_an_object_of_python_stands_in_a_resolved_experiment_by_its_class() -> None:
    class Own:
        pass

    assert plain({"plant": [Own(), 3, None]}) == {"plant": [f"{__name__}.{Own.__qualname__}", 3, None]}


def test_a_log_runs_no_module_and_a_file_makes_no_object_of_python(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.py").write_text("raise SystemExit('a log has run it')")
    monkeypatch.chdir(tmp_path)
    resolved = load_experiment("dc-motor-hinf").resolved()
    for kind in ("mine:Plant", registry.object_kind(SimpleNamespace)):
        named = resolved | {"plant": {"kind": kind, "gain": 1.0}}
        absent, why = experiment_from_resolved(named, "", "log").plant, f"{kind}, which the log does not hold"
        assert absent == UnavailablePlugin(field="plant", kind=kind, why=why, said={"gain": 1.0})
        with pytest.raises(HilError, match="which the log does not hold"):
            absent.model()
    with pytest.raises(ExperimentError, match=r"plant\.kind: 'object .*cannot be made from .* file; give the object"):
        parse_experiment(changed('kind = "dc-motor"', f'kind = "{registry.object_kind(SimpleNamespace)}"'))
    law = {"sc": resolved["network"]["sc"] | {"law": {"kind": "mine:Law"}}}
    with pytest.raises(ExperimentError, match=r"network\.sc\.law\.kind: 'mine:Law' cannot be made .*; say where its file stands"):
        experiment_from_resolved(resolved | {"network": resolved["network"] | law}, "", "log")
