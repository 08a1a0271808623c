"""What a command shows while it computes: on a terminal what it does, how far it is and for how long; elsewhere nothing."""

from __future__ import annotations

from typing import Any


class Working:
    """A line on a terminal's standard error from here to the end of the block, silence elsewhere.

    Nothing may be printed inside the block, and no other picture drawn.

    Args:
        title: what is computed.
    """

    def __init__(self, title: str) -> None:
        from rich.console import Console
        from rich.markup import escape
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        from hil.cli.terminal import visible

        console = Console(stderr=True)
        columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn())
        self._bar = Progress(*columns, console=console, disable=not console.is_terminal, transient=True)
        self._title = escape(visible(title))
        self._task: Any = None

    def __enter__(self) -> Working:
        self._bar.start()
        self._task = self._bar.add_task(self._title, total=None)
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, stage: str, done: int, total: int, value: float) -> None:
        """Show how far a design is, and the norm that it has reached."""
        self._bar.update(self._task, description=f"{self._title}: {stage} norm {value:.6g}", completed=done, total=total)
