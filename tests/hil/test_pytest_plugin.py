"""The pytest plug-in, used as its users use it: in a pytest of its own."""

from __future__ import annotations

import pytest

pytest_plugins = ["pytester"]


def test_fixture_runs_an_experiment_and_names_the_log_of_a_failure(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(
        """
        def test_tracks(hil):
            session = hil.run("dc-motor-hinf", seed=3, duration="12 s")
            assert session.status == 0
            assert session.summary["metrics"]["sse_after_5s"] < 0.06
            assert len(session.run.arrays["/plant/state"]) == 240

        def test_fails(hil):
            hil.run("dc-motor-h2", duration="2 s")
            assert False
        """
    )
    result = pytester.runpytest_subprocess("-p", "no:cacheprovider")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*hil log*", "dc-motor-h2 seed 0: *.mcap"])


def test_missing_vcan_skips_with_the_remedy_and_fails_on_demand(pytester: pytest.Pytester) -> None:
    from hil.pytest_plugin import has_vcan

    if has_vcan():
        pytest.skip("there is a vcan0 here, so nothing can be missing")
    pytester.makepyfile("import pytest\n@pytest.mark.vcan\ndef test_bus(): pass")
    result = pytester.runpytest_subprocess("-rs")
    result.assert_outcomes(skipped=1)
    result.stdout.fnmatch_lines(["*make test-vcan*"])
    assert pytester.runpytest_subprocess("--hil-require=vcan").ret == pytest.ExitCode.USAGE_ERROR


def test_unknown_requirement_is_refused(pytester: pytest.Pytester) -> None:
    pytester.makepyfile("def test_nothing(): pass")
    assert pytester.runpytest_subprocess("--hil-require=lidar").ret == pytest.ExitCode.USAGE_ERROR
