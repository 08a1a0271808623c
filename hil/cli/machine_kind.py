"""Which kind of machine this is, to what computes: its processor, and what numpy, OpenBLAS and libm choose by it."""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from hil.runtime.real.machine import processor

KERNELS = {"Haswell": "avx2", "SkylakeX": "avx512f"}
"""Kernels of OpenBLAS, and what a processor must have for them; Nehalem runs on every one of x86-64."""


def vector_units() -> list[str]:
    """Return what numpy can use beyond its baseline, such as X86_V3 and X86_V4."""
    config: Any = np.show_config(mode="dicts")
    return [str(name) for name in config["SIMD Extensions"].get("found", [])]


def blas_kernel() -> str:
    """Return the kernel that OpenBLAS has chosen, such as SkylakeX."""
    return ", ".join(sorted({str(each.get("architecture", "?")) for each in threadpool_info() if each["user_api"] == "blas"}))


def libm() -> str:
    """Return the C library."""
    name, version = platform.libc_ver()
    return f"{name} {version}".strip() or "unknown"


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


def told() -> str:
    """Return all of it in one line."""
    units = ", ".join(vector_units()) or "its baseline"
    return f"{processor()}; numpy uses {units}; OpenBLAS {blas_kernel()}; {libm()}"
