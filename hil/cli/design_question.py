"""What the questions of ``hil design`` are made of, see `hil.cli.design`: their options, and what several of them share."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from inspect import signature
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import click

from design.errors import FieldError
from hil.cli.option_types import Duration, Number
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.design_questions import TrackingTarget
    from plants import Signal

SHAPING: Final = (
    click.Option(["--information"], default="applied", show_default=True,
                 type=click.Choice(["applied", "generated", "tau", "constant", "both", "previous", "total"]),
                 help="What a gain may depend on besides tau: d at application, d at generation (printed rule), nothing, ..."),
    click.Option(["--gain-bound"], type=Number(), help="Bound on every |entry| of every gain."),
    click.Option(["--input-weight"], type=Number(0.0), help="Weight R of the input, equal for every input [0.01]."),
    click.Option(["--z", "output"], type=click.Choice(["stacked", "sum"]), default="stacked", show_default=True,
                 help="z = [Q x; R u], or Q x + R u as printed, whose terms may cancel."),
    click.Option(["--period"], type=Duration(above=True),
                 help="Sample period, such as 25ms [the thesis's, or the experiment's]."),
    click.Option(["--samples"], type=click.IntRange(1, 2), default=1, show_default=True, help="Samples per sensor packet."),
    click.Option(["--sojourns"], type=click.IntRange(1), default=1, show_default=True,
                 help="Slots that tau has lasted which a gain distinguishes; for semi-Markov delays."),
    click.Option(["--row-sojourns"], type=click.IntRange(1), default=1, show_default=True,
                 help="The same for d, with --information applied: a row for each d and each of so many slots."),
    click.Option(["--integral"], type=Number(), default=0.0,
                 help="Weight of the integrated error in z; > 0 adds integral action."),
    click.Option(["--order"], type=click.IntRange(0), default=0, show_default=True,
                 help="States of the controller's own, by which it remembers; 0: static gains."),
    click.Option(["--reference-weight"], type=Number(0.0), default=0.0,
                 help="Size of a step of the reference that counts in z beside an impulse at the input."),
    click.Option(["--starts"], type=click.IntRange(0), default=0, help="Starts of the multistart [by objective]."),
    click.Option(["--seed"], type=click.IntRange(0), default=0, show_default=True, help="Of the starts of the multistart."),
)  # fmt: skip
"""Options that say which gains are sought, and over what; several questions take them."""


class Question(NamedTuple):
    """What is asked, by an option of its own or by the subject.

    Args:
        place: of several questions that are asked, that of the smallest place is answered.
        asked: says so, by all options.
        options: that it alone takes.
        answer: its parameters are the options that mean something with it, ``**shape`` stands for `SHAPING`.
        name: of the question, with the reason, where another option is refused; empty for the plain one.
        page: whether its file is a page.
    """

    place: int
    asked: Callable[[Mapping[str, Any]], object]
    options: Sequence[click.Option]
    answer: Callable[..., None]
    name: str = ""
    page: bool = True

    @property
    def takes(self) -> set[str]:
        """The names of what its answer is given."""
        names = {*signature(self.answer).parameters}
        return names - {"shape"} | names_of(SHAPING) if "shape" in names else names


def names_of(options: Sequence[click.Option]) -> set[str]:
    """Return the names by which options are handed over."""
    return {str(option.name) for option in options}


def shaped(
    subject: str, *, period: float | None, sojourns: int, row_sojourns: int, input_weight: float | None, **shape: Any
) -> tuple[TrackingTarget, dict[str, Any]]:  # fmt: skip
    """Return plant and network of a subject, and the options as `hil.design_questions.problem_for` takes them.

    Raises:
        HilError: an option that does not fit.
    """
    from design.controllers import check_row_sojourns
    from hil.design_questions import tracking_target

    with option_faults():
        check_row_sojourns(row_sojourns, shape["information"], "--information")
    target = tracking_target(subject, period, sojourns, row_sojourns)
    return target, shape | {"R": weight_of(target, input_weight)}


def weight_of(target: TrackingTarget, input_weight: float | None) -> list[float] | None:
    """Return the weight R of every input; None for the default."""
    return None if input_weight is None else [input_weight] * target.B.shape[1]


@contextmanager
def option_faults() -> Iterator[None]:
    """Raise the fault of a field as that of the option of this name.

    Raises:
        HilError: with the option.
    """
    try:
        yield
    except FieldError as error:
        raise HilError(f"--{error.field.replace('_', '-')}: {error.message}") from error


def gain_unit(inputs: Sequence[Signal], of: Sequence[Signal]) -> str:
    """Return the unit of gains from signals to inputs, in words.

    >>> from plants import DCMotor
    >>> gain_unit(DCMotor().inputs, DCMotor().states)
    'V per rad, rad/s'
    """
    return " per ".join(", ".join(dict.fromkeys(signal.unit for signal in signals)) for signals in (inputs, of))
