"""The names of the package are functions and classes, whichever was imported before."""

import subprocess
import sys

from tests.waiting import LIMIT_S

ORDERS = [
    "import design; design.fastest_feedback; design.delayed_hinf; rf, dh = design.fastest_feedback, design.delayed_hinf",
    "from design import analyse_delayed, delayed_hinf as dh, fastest_feedback as rf",
    "from design import delayed_hinf as dh, largest_decay, fastest_feedback as rf; import design; dh = design.delayed_hinf",
    "import design.semi_markov_loop.robust_feedback, design.semi_markov_loop.delayed_hinf; "
    "from design import fastest_feedback as rf, delayed_hinf as dh",
    "import design; design.fastest_feedback; from design import *; rf, dh = fastest_feedback, delayed_hinf",
    "from design import *; rf, dh = fastest_feedback, delayed_hinf",
]


EACH_IN_A_PROCESS = """
import os, sys, types
import numpy, scipy.linalg, scipy.optimize, scipy.stats  # once for all; nothing of ours
assert not any(name.partition(".")[0] == "design" for name in sys.modules)
for order in sys.argv[1:]:
    if os.fork() == 0:
        exec(order)
        assert isinstance(rf, types.FunctionType) and isinstance(dh, types.FunctionType), (order, rf, dh)
        os._exit(0)
    assert os.wait()[1] == 0, order
"""


def test_a_name_means_the_function_every_time():
    found = subprocess.run([sys.executable, "-c", EACH_IN_A_PROCESS, *ORDERS], capture_output=True, text=True, timeout=LIMIT_S)
    assert found.returncode == 0, found.stderr


def test_no_name_is_that_of_a_module_beside_it():
    import pkgutil

    import design

    assert not {module.name for module in pkgutil.iter_modules(design.__path__)} & set(design.__all__)
