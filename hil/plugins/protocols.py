"""What the plug-ins of an experiment fulfil: the protocols by which the loop is composed, run and certified.

Plants have theirs in :mod:`plants.parts.protocols`, controllers in :mod:`design.controllers.contract`, network laws in
:mod:`transport.laws`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from design.controllers import LoopModel, RunningController

if TYPE_CHECKING:
    from design.requests.tracking import DesignTask


@runtime_checkable
class FieldFault(Protocol):
    """A ValueError that names the field at fault, so that it is shown with its path.

    `FieldError` of plants, transport and design is one; a plug-in may raise any of them, or its own.
    """

    field: str
    message: str


class NamedController(Protocol):
    """A controller that says under which plug-in name the log's experiment makes it again."""

    @property
    def kind(self) -> str: ...

    def start(self, model: LoopModel) -> RunningController: ...


@runtime_checkable
class GivesGains(Protocol):
    """A designer whose gains may be written down already, as printed ones are; one without this solves whenever it is asked."""

    @property
    def gains_given(self) -> bool:
        """Whether nothing is solved."""
        ...

    def solve(self, task: DesignTask) -> NamedController: ...


@runtime_checkable
class GainsOnFile(Protocol):
    """A designer whose gains may stand in a file of the user's, with the problem that they solve."""

    file: str

    def unfit(self, task: DesignTask) -> str:
        """Return in what the problem of the file differs from that of the loop; empty where it does not."""
        ...

    def solve_again(self, task: DesignTask) -> NamedController:
        """Return gains that solve what the file asks for, for the loop."""
        ...


@runtime_checkable
class Designer(Protocol):
    """A ``[controller]`` table that says what is to be achieved; what runs is what it solves to.

    It returns gains and nothing else: whether their loop is certified is said by :mod:`hil.certify.certify` alone.
    """

    def solve(self, task: DesignTask) -> NamedController:
        """Return the controller that runs.

        Raises:
            ValueError: a field that does not fit the loop; best one that `FieldFault`.
            DesignError: no gains meet the request; the message has the number that decides it.
        """
        ...
