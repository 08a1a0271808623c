"""``hil design --trade-off``: what a smaller H-infinity norm costs in the H2 norm."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.cli.terminal import print_json
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.design_questions.design_problem import TrackingTarget

SHAPES = frozenset({
    "subject", "trade_off", "information", "gain_bound", "input_weight", "z", "period", "samples", "sojourns",
    "row_sojourns", "integral", "starts", "seed", "path", "force", "as_json",
})  # fmt: skip
"""Options that mean something here."""


def show_trade_off(target: TrackingTarget, options: dict[str, Any], path: Path | None, force: bool, as_json: bool) -> None:
    """Solve the designs of a curve; print the table, and write a page.

    Args:
        target: plant and network.
        options: of the problem.
        path: of the page; None: none is written.
        force: replace a file that is there.
        as_json: print JSON.

    Raises:
        HilError: no gains meet the request, or a file that cannot be written.
    """
    from design.errors import DesignError
    from hil.cli.terminal import Working, print_table, visible
    from hil.design_questions.norm_trade_off import compromises
    from hil.files.outputs import check_page, write_output

    if path is not None:
        check_page(path, force=force)
    try:
        with Working(f"{target.plant} trade-off {options['information']}") as watch:
            found = compromises(target, watch, **options)
    except DesignError as error:
        raise HilError(f"design: {error}") from error
    if path is not None:
        from hil.pages.designs import norm_trade_off_page

        write_output(path, norm_trade_off_page(target.plant, found))
    if as_json:
        print_json({
            "plant": target.plant, "period_s": target.period_s, "information": options["information"],
            "designs": [each.to_json() for each in found],
        })  # fmt: skip
        return
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(visible(f"{target.plant}: smallest H2 norm for every level of the H-infinity norm")))
    for head in ("weight", "level", "H-infinity norm", "H2 norm", "certificate"):
        table.add_column(head, justify="right")
    for each in found:
        level = "-" if each.level is None else f"{each.level:.6g}"
        table.add_row(f"{each.weight:g}", level, f"{each.hinf:.6g}", f"{each.h2:.6g}", each.state)
    print_table(table)
    first, last = found[0], found[-1]
    print(
        f"The H-infinity design costs {first.h2 / last.h2 - 1.0:.2%} more in the H2 norm than the H2 design, which costs "
        f"{last.hinf / first.hinf - 1.0:.2%} more in the H-infinity norm."
    )
