"""The pytest plug-in, used as its users use it: in a pytest of its own, forked from a process that has imported ours."""

from __future__ import annotations

import os
import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from hil import session
from hil.api.pytest_plugin import Runner, folder_of, has_vcan
from hil.errors import HilError
from hil.experiment import shipped
from hil.log.read import read_run
from tests.warm_hil import hil_command

pytest_plugins = ["pytester"]

OUR_GATES = (Path(__file__).parents[2] / "conftest.py").read_text()


@pytest.fixture(autouse=True)
def as_on_a_desk(pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch) -> None:
    """Outside CI, where pytest cuts its summary lines, and without hypothesis, a third of the start of a pytest."""
    monkeypatch.setenv("PYTEST_ADDOPTS", "-p no:hypothesispytest")
    for name in ("CI", "BUILD_NUMBER"):
        monkeypatch.delenv(name, raising=False)


WARM = ("-W", "ignore::pytest.PytestAssertRewriteWarning")
"""What pytest says of modules that a forked process has already."""


def pytest_of(pytester: pytest.Pytester, *words: str) -> pytest.RunResult:
    done = hil_command("-p", "no:cacheprovider", *WARM, *words, cwd=pytester.path, program="pytest")
    return pytest.RunResult(done.returncode, done.stdout.splitlines(), done.stderr.splitlines(), 0.0)


def test_a_name_of_over_100_characters_ends_in_a_digest() -> None:
    most = "t" * 100
    assert folder_of(f"a.py::{most}").name == most
    first, second = (folder_of(f"a.py::{most}{more}").name for more in "uv")
    assert first != second and {first[:101], second[:101]} == {f"{most}-"} and len(first) == len(second) == 109


def test_an_interface_that_no_machine_has_is_not_there() -> None:
    assert has_vcan("no-interface") is False


def test_fixture_runs_an_experiment_and_says_of_a_failure_why_and_how_to_see_more(pytester: pytest.Pytester) -> None:
    """One child for three properties: what a run gives, what a failure says, and the assertions of the fixture."""
    pytester.makepyfile(
        """
        def test_tracks(hil):
            session = hil.run("dc-motor-hinf", seed=3, duration="12 s")
            assert session.status == 0
            assert session.summary["metrics"]["sse_after_5s"] < 0.06
            assert len(session.run.arrays["/plant/state"]) == 240

        def test_fails(hil):
            session = hil.run("dc-motor-h2", duration=2, **{"limits.state.angle": 1.0})
            assert session.status == 0

        def test_law(hil):
            hil.assert_law(hil.run("dc-motor-hinf", seed=1), "ca")

        def test_probability(hil):
            hil.assert_probability("dc-motor-hinf", lambda s: s.metrics["sse"] < 1, at_least=0.5, duration=2)
        """
    )
    result = pytest_of(pytester)
    result.assert_outcomes(passed=2, failed=2)
    result.stdout.fnmatch_lines(["*required 0.5, observed 0 of 10 runs*failed seeds: 0, 1, 2*hil run dc-motor-hinf --seed 0*"])
    result.stdout.no_fnmatch_line("*return function(*args*")  # the line of the test, none of ours
    result.stdout.fnmatch_lines([
        "*hil log*", "dc-motor-h2 seed 0: *.mcap", "status 3, virtual time, * slots", "safety: *angle*",
        "hil report *.mcap *", "hil replay *.mcap *", "hil export *.mcap -o *.npz *",
    ])  # fmt: skip


def test_junit_keeps_what_a_failing_test_ran_and_its_three_commands_run(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_fails(hil):
            session = hil.run("dc-motor-hinf", seed=7, duration=2)
            print("sse", repr(session.metrics["sse"]))
            assert False
        """
    )
    result = pytest_of(pytester, "--junitxml=j.xml", "--hil-logs=kept")
    result.assert_outcomes(failed=1)
    kept = {p.get("name"): p.get("value") for p in ElementTree.parse(pytester.path / "j.xml").iter("property")}
    (sse,) = [line.removeprefix("sse ") for line in result.outlines if line.startswith("sse ")]
    assert kept["hil_seed"] == "7" and kept["hil_verdict"] == "certified" and kept["hil_timing"] == "valid"
    assert kept["hil_metric_sse"] == sse and str(kept["hil_log"]).endswith(".mcap")
    assert "None" not in kept.values() and "hil_metric_sse_after_5s" not in kept  # it lasted 2 s
    result.stdout.fnmatch_lines(["verdict: certified", f"metric_sse: {float(sse):.6g} rad² s"])
    reported = [line.partition("   # ")[0].split() for line in result.outlines if "   # " in line]
    assert [command[1] for command in reported] == ["report", "replay", "export"]
    assert all(hil_command(*words[1:], cwd=pytester.path).returncode == 0 for words in reported)


def test_a_fixture_that_fails_says_the_same_as_a_test(pytester: pytest.Pytester) -> None:
    pytester.makeconftest(
        """
        import pytest

        @pytest.fixture
        def typo(hil):
            return hil.run("nosuch.toml")

        @pytest.fixture
        def tracked(hil):
            session = hil.run("dc-motor-hinf", duration=2, set=["plant.gain=150"])
            assert session.status == 1
        """
    )
    pytester.makepyfile("def test_one(typo): pass\ndef test_two(tracked): pass")
    result = pytest_of(pytester, "--no-header")
    result.assert_outcomes(errors=2)
    (line,) = (line for line in result.outlines if "nosuch" in line and "ERROR" not in line)
    assert line.startswith("no experiment 'nosuch.toml'") and f"neither a file in {pytester.path}" in line
    assert f"{pytester.path}/conftest.py:5: HilError" in result.outlines
    result.stdout.fnmatch_lines(["*hil log*", "dc-motor-hinf seed 0: *.mcap", "with plant.gain=150, duration=2", "hil report *"])


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--hil-logs=file/logs",), "--hil-logs: file/logs: cannot be made: Not a directory"),
        (("--hil-link=can:hil:rig0",), "hil: virtual time uses no link: --hil-link can:hil:rig0 needs --hil-clock real"),
    ],
)
def test_an_option_that_cannot_act_says_so_once(pytester: pytest.Pytester, options: tuple[str, ...], says: str) -> None:
    pytester.makepyfile("def test_nothing(): pass")
    (pytester.path / "file").write_text("")
    result = pytest_of(pytester, *options)
    lines = [*result.outlines, *result.errlines]
    assert len([line for line in lines if says in line]) == 1 and len(lines) < 12


@pytest.mark.parametrize(
    ("arguments", "options", "wrong", "right"),
    [
        ("**{'plant.gian': 3, 'limits.inpt': 1}", (), "gian", "gain"),
        # of a package below `hil`, whose errors are not of its root
        ("duration=1", ("--hil-clock=real", "--hil-link=cna:hil:x"), "cna:hil:x", "can:hil:x"),
    ],
)
def test_a_wrong_key_or_link_is_one_line_for_each_fault(
    pytester: pytest.Pytester, arguments: str, options: tuple[str, ...], wrong: str, right: str
) -> None:
    pytester.makepyfile(f"def test_typo(hil):\n    hil.run('dc-motor-hinf', {arguments})")
    result = pytest_of(pytester, "--no-header", *options)
    result.assert_outcomes(failed=1)
    (line,) = (line for line in result.outlines if wrong in line and "FAILED" not in line)
    assert f"did you mean '{right}'" in line and any(re.search(r"test_a_wrong_key.*\.py:2: ", line) for line in result.outlines)
    assert not any(re.match("FAILED .* - /", line) for line in result.outlines)  # its few words say what is wrong, not where
    assert len(result.outlines) < 15, "no traceback of ours"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"clock": "fast"}, "hil.run: clock: 'fast'; expected 'virtual' or 'real'"),  # it would run for 50 s in real time
        ({"link": 5, "clock": "real"}, "hil.run: link: 5; expected text or None"),
        ({"set": "plant.gain=150"}, "hil.run: set: 'plant.gain=150'; expected a list of text"),
    ],
)
def test_an_argument_of_another_kind_is_refused_in_the_words_of_the_fixture(given: Any, said: str, tmp_path: Path) -> None:
    with pytest.raises(HilError, match=re.escape(said)):
        Runner(tmp_path, "virtual", None, None).run("dc-motor-hinf", **given)


def test_the_assertions_of_the_face_show_the_line_of_the_test_and_none_of_ours(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import hil

        def test_rare():
            hil.assert_probability("dc-motor-hinf", lambda s: False, at_least=0.5, duration=1)

        def test_number():
            hil.assert_probability("dc-motor-hinf", lambda s: True, at_least=1.5)

        def test_side():
            hil.assert_law(hil.run("dc-motor-hinf", duration=1), "cs")
        """
    )
    result = pytest_of(pytester, "--no-header")
    result.assert_outcomes(failed=3)
    assert all(reported in result.stdout.str() for reported in ("failed seeds: 0, 1", "at_least: 1.5", "side 'cs'"))
    assert not any("assertions.py" in line or "Returns:" in line for line in result.outlines), "a traceback of ours"


def test_markers_of_other_projects_are_left_alone(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest

        @pytest.mark.slow
        def test_slow(): pass

        @pytest.mark.vcan
        @pytest.mark.chromium
        @pytest.mark.cyclictest
        @pytest.mark.hostile
        @pytest.mark.hil_vcan
        def test_theirs(): pass
        """
    )
    pytester.runpytest_inprocess().assert_outcomes(passed=2)


def test_missing_vcan_skips_only_users_of_the_fixture_and_fails_on_demand(pytester: pytest.Pytester) -> None:
    from hil.api.pytest_plugin import has_vcan

    if has_vcan():
        pytest.skip("there is a vcan0 here, so nothing can be missing")
    pytester.makepyfile("import pytest\n@pytest.mark.hil_vcan\ndef test_bus(hil): pass\ndef test_other(hil): pass")
    result = pytest_of(pytester, "-rs")
    result.assert_outcomes(skipped=1, passed=1)
    result.stdout.fnmatch_lines(["*ip link add dev vcan0*"])
    assert pytester.runpytest_inprocess("--hil-require=vcan", "-k", "other").ret == pytest.ExitCode.USAGE_ERROR


def test_our_own_gates_skip_with_the_remedy_and_fail_on_demand(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytester.makeconftest(OUR_GATES)
    pytester.makepyfile("import pytest\n@pytest.mark.cyclictest\n@pytest.mark.slow\ndef test_long(): pass")
    result = pytester.runpytest_inprocess("-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*--hil-slow*"])
    assert "unrecognized" not in pytester.runpytest_inprocess("--hil-slow", "--hil-hostile").stdout.str()
    monkeypatch.setenv("PATH", "/nonexistent")
    result = pytester.runpytest_inprocess("--hil-require=cyclictest")
    assert result.ret == pytest.ExitCode.USAGE_ERROR and "apt-get install rt-tests" in result.stderr.str()


def test_unknown_requirement_is_refused(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_nothing(): pass")
    assert pytester.runpytest_inprocess("--hil-require=lidar").ret == pytest.ExitCode.USAGE_ERROR


def test_logs_of_tests_with_one_name_lie_apart_and_no_run_overwrites_another(pytester: pytest.Pytester) -> None:
    test = "import pytest\n@pytest.mark.parametrize('n', [1, 2])\ndef test_step(hil, n): hil.run('dc-motor-hinf', duration=1)"
    for name in ("one", "two"):
        (pytester.mkdir(name) / f"test_{name}.py").write_text(test)
    for runs in (1, 2):
        pytest_of(pytester, "--hil-logs=kept").assert_outcomes(passed=4)
        logs = sorted(p.relative_to(pytester.path / "kept").as_posix() for p in (pytester.path / "kept").rglob("*.mcap"))
        assert len(logs) == 4 * runs
    assert logs[:2] == [f"one/test_one.py/test_step[1]/dc-motor-hinf-{n}.mcap" for n in (0, 1)]


@pytest.mark.realtime
def test_runs_of_one_test_at_once_have_a_log_each(tmp_path: Path) -> None:
    rig = Runner(tmp_path, "virtual", None, None)
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda seed: rig.run("dc-motor-hinf", seed=seed, duration=0.2), range(4)))
    logs = [each.summary["log"]["path"] for each in found]
    assert len({*logs}) == 4 and [read_run(log).metadata["seed"] for log in logs] == ["0", "1", "2", "3"]


def test_workers_of_xdist_have_a_channel_each(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        import pytest

        @pytest.mark.parametrize("seed", range(2))
        def test_runs(hil, seed):
            assert hil.run("dc-motor-hinf", seed=seed, duration=0.5).status == 0
        """
    )
    link = f"--hil-link=can:hil:two{os.getpid()}"
    result = pytester.runpytest_subprocess("-n", "2", "--hil-clock", "real", link, "-p", "no:cacheprovider")
    result.assert_outcomes(passed=2)



def test_timing_that_is_not_valid_fails_where_it_is_required(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = session.run_session

    def late(*given: object, **options: object) -> object:
        done = kept(*given, **{**options, "clock": "virtual", "link": None})  # type: ignore[arg-type]
        done.summary["timing"] |= {"valid": False, "why": ["16 of 40 slots had no answer in time"]}
        return done

    monkeypatch.setattr(session, "run_session", late)
    Runner(tmp_path / "a", "real", "local:", None).run("dc-motor-hinf", duration="1s")
    with pytest.raises(pytest.fail.Exception, match=r"--hil-require=timing: dc-motor-hinf is NOT VALID: 16 of 40"):
        Runner(tmp_path / "b", "real", "local:", None, True).run("dc-motor-hinf", duration="1s")


SLOW = '''
import time
from dataclasses import dataclass
from typing import ClassVar

@dataclass(frozen=True, kw_only=True)
class Slow:
    selection: ClassVar = "constant"

    def start(self, model):
        return self

    def rows(self, k, tau, y, r):
        if k % 10 == 9:
            time.sleep(0.1)  # two periods
        return ((0.0,),)
'''


@pytest.mark.realtime
def test_a_controller_that_is_late_fails_where_timing_is_required(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(slow=SLOW)
    (pytester.path / "e.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    pytester.makepyfile(
        """
        def test_runs(hil):
            hil.run("e.toml", duration="1s", controller={"kind": "slow:Slow"}, allow_uncertified=True,
                    **{"limits.watchdog_slots": 1000})
        """
    )
    words = ("--hil-clock=real", f"--hil-link=can:hil:late{os.getpid()}")
    required = pytest_of(pytester, *words, "--hil-require=timing", "--junitxml=j.xml")
    required.assert_outcomes(failed=1)
    required.stdout.fnmatch_lines(["*--hil-require=timing: dc-motor-hinf is NOT VALID: *"])
    (found,) = [p for p in ElementTree.parse(pytester.path / "j.xml").iter("property") if p.get("name") == "hil_timing"]
    assert (found.get("value") or "").startswith("NOT VALID: ")
