"""The one error root of the package: a design that cannot be, with the number that decides it; a package that is missing."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from importlib import import_module
from numbers import Real
from typing import Any


class DesignError(Exception):
    """A request that no computation can fulfil, or a computation that did not reach a certified end.

    Args:
        message: what was asked, what was found, what was expected.
        value: the number that decides (a spectral radius, a norm, an eigenvalue), if there is one.
    """

    def __init__(self, message: str, *, value: float | None = None) -> None:
        super().__init__(message)
        self.value = value


class NotStable(DesignError):
    """The closed loop is not mean-square stable; ``value`` is the radius of its second-moment operator."""


class NotInstalled(DesignError):
    """A package of an extra is not there: nothing was asked of the theory."""


INSTALL = "pip install 'hilrig[design]'"


def solver(package: str) -> Any:
    """Return a package of the extra ``design``: cvxpy, Clarabel or SCS.

    Args:
        package: as it is imported.

    Raises:
        NotInstalled: it is not installed, with the command that installs it.
    """
    try:
        return import_module(package)
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != package:
            raise
        raise NotInstalled(f"this needs {package}, which is not installed: {INSTALL}") from None


def check_solvers() -> None:
    """Raise NotInstalled where one of them is missing: before long work, and not in its midst."""
    for package in ("cvxpy", "clarabel", "scs"):
        solver(package)


class TooLarge(DesignError):
    """A loop of more modes or states than is computed with: nothing of it was built, and nothing is known."""


class Infeasible(DesignError):
    """No gains meet the request; ``value`` is the best number that was reached.

    Args:
        message: what was asked, what was found.
        value: the best number that was reached, if there is one.
        proved: it is proved that there are none; otherwise none were found.
    """

    def __init__(self, message: str, *, value: float | None = None, proved: bool = False) -> None:
        super().__init__(message, value=value)
        self.proved = proved


class FieldError(ValueError):
    """A value that does not fit, with the field that holds it; its text is ``field: message``.

    Args:
        field: the parameter, or the path to it: ``latency.file``, ``sojourn[2]``.
        message: what is wrong: the value, what was expected.
    """

    def __init__(self, field: str, message: str) -> None:
        super().__init__(field, message)
        self.field, self.message = field, message

    def __str__(self) -> str:
        return f"{self.field}: {self.message}"


def check_finite(**values: float) -> None:
    """Refuse the first number that is not finite, by its field.

    Raises:
        FieldError: as all of these.
    """
    _check(values, lambda value: True, "a finite number")


def check_above_zero(**values: float | None) -> None:
    """Refuse the first number that is not finite and above 0; None is no number."""
    _check(values, lambda value: value > 0.0, "a finite number above 0")


def check_at_least_zero(**values: float) -> None:
    """Refuse the first number that is not finite and at least 0."""
    _check(values, lambda value: value >= 0.0, "a finite number, at least 0")


def _check(values: Mapping[str, float | None], fits: Callable[[float], bool], expected: str) -> None:
    for field, value in values.items():
        if value is not None and not (isinstance(value, Real) and math.isfinite(value) and fits(value)):
            raise FieldError(field, f"{value!r}, expected {expected}")
