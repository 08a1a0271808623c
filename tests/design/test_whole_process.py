"""One thread for every BLAS of a process, whenever it was loaded."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tests.waiting import LIMIT_S

LOADED_LATER = """
import numpy
from threadpoolctl import threadpool_info
from design.whole_process import one_blas_thread

def threads():
    return sorted(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")

with one_blas_thread():
    print(threads())
import scipy.linalg  # which brings a BLAS of its own
before = threads()
with one_blas_thread():
    print(threads())
print(before == threads())
"""


def test_a_blas_that_was_loaded_after_the_first_look_is_limited_too_and_gets_its_threads_back() -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"}
    done = subprocess.run(
        [sys.executable, "-c", LOADED_LATER], env=environment, capture_output=True, text=True, check=True, timeout=LIMIT_S
    )
    assert done.stdout.splitlines() == ["[1]", "[1, 1]", "True"]


BEGUN = """
import os, sys
first = sys.argv[1:] == ["loaded first"]
if first:
    import numpy
from design.whole_process import begin_with_one_thread, one_blas_thread

begin_with_one_thread()
import numpy
with one_blas_thread():
    asked = "threadpoolctl" in sys.modules
from threadpoolctl import threadpool_info
with one_blas_thread():
    print(asked, {each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"})
"""


@pytest.mark.parametrize(("threads", "order", "asked"), [("1", "", False), ("2", "", True), ("1", "loaded first", True)])
def test_a_blas_is_asked_for_its_threads_unless_it_began_with_one(threads: str, order: str, asked: bool) -> None:
    own = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    environment = {**own, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": threads}
    done = subprocess.run(
        [sys.executable, "-c", BEGUN, order], env=environment, capture_output=True, text=True, check=True, timeout=LIMIT_S
    )
    assert done.stdout == f"{asked} {{1}}\n"
