"""What stands for other processors here, as many of it in one process as go together: each is of another library.

A difference of any of them is a difference of the process; ``--hil-slow`` tries each alone, and so says whose it is.
"""

from __future__ import annotations

import platform
from pathlib import Path

from hil.cli.doctor import blas_kernel, vector_units

KERNELS = {"Haswell": "avx2", "SkylakeX": "avx512f"}
"""Kernels of OpenBLAS, and what a processor must have for them; Nehalem runs on every one of x86-64."""


def stand_ins() -> dict[str, dict[str, str]]:
    """Return what stands for another processor here, name to environment."""
    found = {f"numpy without {name}": {"NPY_DISABLE_CPU_FEATURES": " ".join(names)} for name, names in _without().items()}
    if platform.machine() == "x86_64":
        flags = _flags()
        fits = ["Nehalem", *(kernel for kernel, flag in KERNELS.items() if flag in flags)]
        found |= {f"OpenBLAS {kernel}": {"OPENBLAS_CORETYPE": kernel} for kernel in fits if kernel != blas_kernel()}
        if {"avx2", "fma"} & flags:
            found["glibc without FMA and AVX2"] = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-FMA,-FMA4"}
    return found


def _without() -> dict[str, list[str]]:
    """Return for each of numpy's levels those that have to be switched off with it: itself and what is above."""
    found = vector_units()
    return {name: found[i:] for i, name in enumerate(found) if name.startswith("X86_V") or len(found) == 1}


def _flags() -> set[str]:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return set(next((line for line in lines if line.startswith("flags")), "").split())


def together() -> dict[str, dict[str, str]]:
    """Return environments of few processes, name to environment, that together hold every stand-in.

    >>> alone = stand_ins()
    >>> sorted(name for names in together() for name in names.split(", ")) == sorted(alone)
    True
    """
    found: list[dict[str, dict[str, str]]] = []
    for name, environment in stand_ins().items():
        free = next((one for one in found if not any(environment.keys() & other.keys() for other in one.values())), None)
        if free is None:
            found.append(free := {})
        free[name] = environment
    return {", ".join(one): {key: value for each in one.values() for key, value in each.items()} for one in found}
