"""What a slot is made of: rig, controller node, safety. Nodes do no I/O and read no clock.

Each part draws from a random stream of its own name, so that adding a component never shifts another's draws.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache

import numpy as np


def rng_for(seed: int, name: str) -> np.random.Generator:
    """Return the generator of one named stream of a run.

    Args:
        seed: the experiment's seed.
        name: name of the stream, such as ``"link.sc"``.

    >>> a, b = rng_for(0, "link.sc"), rng_for(0, "link.ca")
    >>> bool(a.random() == rng_for(0, "link.sc").random()), bool(a.random() == b.random())
    (True, False)
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence([seed, *_words(name)])))


def begun(name: str, first: int) -> str:
    """Return the name of the stream of what begins in a slot: what takes over in a run repeats no number of what ran before.

    >>> begun("link.ca", 0), begun("link.ca", 40)
    ('link.ca', 'link.ca from slot 40')
    """
    return f"{name} from slot {first}" if first else name


@lru_cache(maxsize=64)
def _words(name: str) -> tuple[int, ...]:
    return tuple(np.frombuffer(hashlib.sha256(name.encode()).digest(), dtype=np.uint32).tolist())
