"""The same work for several arguments on all cores; every split gives the same numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from design.monte_carlo.random_streams import safe_path
from hil.reproduce.chapter import ReportProgress

T = TypeVar("T")


def on_all_cores(
    work: Callable[..., T], asked: Sequence[Sequence[Any]], report_progress: ReportProgress, names: Sequence[str]
) -> list[T]:
    """``work(*arguments)`` for all of them, in their order; progress is reported as each ends. Give the longest first."""
    from joblib import Parallel, delayed

    run = Parallel(n_jobs=-1, inner_max_num_threads=1, backend="loky", batch_size=1, return_as="generator_unordered")
    found: dict[int, T] = {}
    report_progress(f"{len(asked)} pieces", 0, len(asked))
    with safe_path():
        for at, result in run(delayed(_numbered)(at, work, *arguments) for at, arguments in enumerate(asked)):
            found[at] = result
            report_progress(names[at], len(found), len(asked))
    return [found[at] for at in range(len(asked))]


def _numbered(at: int, work: Callable[..., T], *arguments: Any) -> tuple[int, T]:
    return at, work(*arguments)
