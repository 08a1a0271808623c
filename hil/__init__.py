"""Test a networked controller without the hardware.

::

    import hil

    session = hil.run("dc-motor-hinf", seed=3, **{"plant.gain": 150})
    session.metrics["sse"]                       # a number, session.summary["units"]["sse"] its unit
    session.arrays["/plant/measurement"]         # a structured numpy array per topic of the log
    hil.run("dc-motor-hinf", plant=Cart(mass=2.0), controller=MyLaw())   # objects of your own, see hil guide

========================  =======================================================================
`load_experiment`         a shipped name or a TOML file, checked: every fault is reported at once
`run`                     run it, in virtual or real time, with or without a log: a `Session`
`simulate`                run it in virtual time, in memory only: a `Run`
`read_run`                a log, read back: a `Run`
`report`                  one self-contained page of a session or a log
`verify`                  run a log again, bit for bit, with the objects that no file holds
`sweep`, `compare`        many seeds of one experiment, at one point or many; several experiments on the same delays
`design`                  gains for a plant over a network, with their norms and bounds
`laws`                    what an experiment's network laws do in the long run
`reproduce`               every number of a chapter of the thesis beside a computed one
`assert_probability`      a condition holds with at least some probability: Wald's sequential test
`assert_law`              the delays of a run are those of its network law
`HilError`                what all of them raise for what the caller can mend
========================  =======================================================================

Importing this package costs nothing: each name brings its module when it is first used. ``hil guide`` prints the guide.

>>> import hil
>>> hil.run("dc-motor-hinf", seed=3, duration=2)
<Session dc-motor-hinf seed 3, virtual time, 40 slots, squared tracking error 11.407 rad² s>
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # the import of typing takes time
if TYPE_CHECKING:
    from hil.api.assertions import assert_law as assert_law
    from hil.api.assertions import assert_probability as assert_probability
    from hil.api.experiment_source import load_experiment as load_experiment
    from hil.api.face import compare as compare
    from hil.api.face import report as report
    from hil.api.face import run as run
    from hil.api.face import simulate as simulate
    from hil.api.face import sweep as sweep
    from hil.api.face import verify as verify
    from hil.api.questions import DesignResult as DesignResult
    from hil.api.questions import design as design
    from hil.api.questions import laws as laws
    from hil.errors import ExperimentError as ExperimentError
    from hil.errors import HilError as HilError
    from hil.experiment import Experiment as Experiment
    from hil.log.read import read_run as read_run
    from hil.log.run import Run as Run
    from hil.session import Session as Session
    from hil.sweeps import Sweep as Sweep
    from hil.sweeps.comparison import Comparison as Comparison
    from hil.sweeps.parameters import ParameterSweep as ParameterSweep
    from hil.thesis import reproduce as reproduce

with open(f"{__path__[0]}/__init__.py", encoding="utf-8") as _face:
    _HOMES = {words[3]: words[1] for words in map(str.split, _face) if words[0:1] + words[4:5] == ["from", "as"]}
"""Module of each public name, as the imports for type checkers have them."""

__all__ = sorted(_HOMES)  # noqa: PLE0605


if not TYPE_CHECKING:

    def __getattr__(name: str) -> object:
        if name not in _HOMES:
            longer = next((each for each in __all__ if each.startswith(f"{name}_")), None)  # a near one Python finds itself
            near = f"; did you mean {longer!r}?" if longer else ""
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}{near}", name=name, obj=sys.modules[__name__])
        from importlib import import_module

        import_module("hil.plugins").refuse_shadowed_packages()
        return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
