"""``--trade-off``: what a smaller H-infinity norm costs in the H2 norm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hil.cli.design_question import Question, shaped
from hil.cli.page_text import show_page
from hil.cli.terminal import Working


def answer(subject: str, path: Path | None, **shape: Any) -> None:
    """Solve the designs of a curve."""
    from hil.design_questions import compromises
    from hil.pages.designs import norm_trade_off_page

    target, options = shaped(subject, **shape)
    with Working(f"{target.plant} trade-off {options['information']}") as watch:
        found = compromises(target, watch, **options)
    document = {
        "plant": target.plant, "period_s": target.period_s, "information": options["information"],
        "designs": [each.to_json() for each in found],
    }  # fmt: skip
    show_page(norm_trade_off_page(target.plant, found), document, path)


QUESTION = Question(
    40, lambda options: options["trade_off"],
    [click.Option(["--trade-off"], is_flag=True,
                  help="H2 against H-infinity norm, mixed designs between the pure ones; -o: a page.")],
    answer, "--trade-off, which solves designs of all three objectives",
)  # fmt: skip
