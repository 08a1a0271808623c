"""The one place for certificates: what is claimed of the loop that will run, by what proof, under what assumptions.

Nothing else says whether a loop is certified: a design hands over gains, a plant its matrices and rates, and a certifier per
kind of loop judges them as they run. To add a kind of loop, write a :class:`hil.certify.Certifier` over the
protocols of its plant and controller, and yield it in `certifiers`. A plant or controller of a user's own that fulfils the
protocols is judged like ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from design.errors import TooLarge
from design.verdict import Verdict
from hil.certify import (
    CertificationProblem,
    Certifier,
    limited_to_received,
    limited_to_sound,
    limited_to_undamped,
    limited_to_whole,
    undecided,
    why_no_controller,
)
from hil.certify.conformance import tested
from hil.certify.send_all_loop import certify_linear_law, certify_send_all
from hil.errors import ForeignVerdict
from hil.plugins import is_ours
from hil.rig import RigSpec
from transport.laws import ChainLaw, SemiMarkovLaw


def certifiers() -> Iterator[Certifier]:
    """Yield who is asked, in order: the first that knows the kind of loop answers, and what others import is not imported."""
    yield certify_send_all
    from hil.certify.historical_loop import certify_historical
    from hil.certify.jump_loop import certify_jump_loop
    from hil.certify.wall_loop import certify_model_following, certify_wall_loop

    yield from (certify_jump_loop, certify_wall_loop, certify_model_following, certify_historical, certify_linear_law)


def certify(loop: CertificationProblem, asked: Iterable[Certifier] | None = None) -> Verdict:
    """Return the verdict on a loop whose plant and controller were tested to be what they say: see `judge` and `tested`.

    Args:
        loop: the loop that will run.
        asked: certifiers, in order; by default those of `certifiers`.

    Raises:
        ForeignVerdict: as of `judge`.
    """
    return tested(loop, judge(loop, asked))


def _too_large(loop: CertificationProblem, error: MemoryError) -> str:
    sizes = [f"{chain.modes} modes of {name}" for name, chain in (("sc", loop.sc), ("ca", loop.ca)) if chain is not None]
    return f"its proof takes more memory than there is, over {' times '.join(sizes)}: {str(error) or 'no memory'}; shorten a " \
        "sojourn law's tail (a larger p or beta, a smaller q, or a table)"


def of_external(verdict: Verdict, named: str) -> Verdict:
    """Return what is known of a loop whose controller is an external program: nothing, whatever the named one is worth.

    Args:
        verdict: on the loop of the controller that the experiment names.
        named: its kind.
    """
    worth = f"{verdict.state}, {verdict.kind}: {verdict.reason}"
    return Verdict(
        kind=verdict.kind, state="undecided", digest=verdict.digest,
        reason=f"the controller is not the experiment's: an external program answers on the link, not {named!r}",
        details={"controller": "external", "stable": False, "the named controller would be": worth},
    )  # fmt: skip


def judge(loop: CertificationProblem, asked: Iterable[Certifier] | None = None) -> Verdict:
    """Return the verdict on what a loop says of itself: ``undecided`` where no certifier knows its kind, or no proof is computed.

    Args:
        loop: the loop that will run.
        asked: certifiers, in order; by default those of `certifiers`.

    Raises:
        ForeignVerdict: a certifier answered for another loop than the one it was handed.
    """
    for certifier in certifiers() if asked is None else asked:
        try:
            verdict = certifier(loop)
        except (np.linalg.LinAlgError, OverflowError) as error:
            said = f"its proof cannot be computed in double precision: {error}"
            return limited_to_received(loop, undecided(loop, "mean-square stability", said))
        except TooLarge as error:
            return undecided(loop, "mean-square stability", str(error))
        except MemoryError as error:
            return undecided(loop, "mean-square stability", _too_large(loop, error))
        if verdict is not None:
            if verdict.digest != loop.digest:
                raise ForeignVerdict(f"{certifier!r}: its verdict is on system {verdict.digest[:12]}, not on {loop.digest[:12]}")
            if loop.unmet and verdict.state != "undecided":
                verdict = verdict.assuming(loop.unmet)
            verdict = limited_to_received(loop, verdict)
            return limited_to_sound(loop, limited_to_undamped(loop, limited_to_whole(loop, verdict)))
    return undecided(loop, "mean-square stability", why_no_controller(loop.controller))


def own_laws(rig: RigSpec) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the places of the laws that draw modes of a chain, among `RigSpec.laws`, and the assumptions on all own laws.

    A run is compared with these laws, and its verdict names the assumptions.

    Args:
        rig: the rig that runs.
    """
    names = (*(f"{sensor.path}.law" for sensor in rig.sensors), "network.ca.law")
    drawn, said = [], []
    for i, (law, name) in enumerate(zip(rig.laws, names)):
        if is_ours(law):
            continue
        if isinstance(law, ChainLaw | SemiMarkovLaw) and law.family == "age":
            drawn.append(i)
            said.append(f"{name} draws as the chain that it states: its modes are counted when it is read, and in the run")
        else:
            said.append(f"{name} is as the chain of ages that it states: in the run it is not compared")
    return tuple(drawn), tuple(said)
