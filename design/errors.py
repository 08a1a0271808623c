"""The one error root of the package: a design that cannot be, told with the number that decides it."""

from __future__ import annotations


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


class Infeasible(DesignError):
    """No gains meet the request; ``value`` is the best number that was reached."""
