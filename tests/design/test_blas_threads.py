"""One thread for every BLAS of a process, whenever it was loaded."""

from __future__ import annotations

import os
import subprocess
import sys

from tests.waiting import LIMIT_S

LOADED_LATER = """
import numpy
from threadpoolctl import threadpool_info
from design.blas_threads import one_blas_thread

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
