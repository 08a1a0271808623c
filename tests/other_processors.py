"""What stands for other processors here, as many of it in one process as go together: each is of another library.

A difference of any of them is a difference of the process; ``--hil-slow`` tries each alone, and so says whose it is.
"""

from __future__ import annotations

from hil.cli.doctor import stand_ins


def together() -> dict[str, dict[str, str]]:
    """Return environments of few processes, name to environment, that together hold every stand-in.

    >>> alone = stand_ins()
    >>> sorted(name for names in together() for name in names.split(", ")) == sorted(alone)
    True
    """
    found: list[dict[str, dict[str, str]]] = []
    for name, environment in stand_ins().items():
        free = next((one for one in found if not any(environment.keys() & other.keys() for other in one.values())), None)
        if free is None:
            found.append(free := {})
        free[name] = environment
    return {", ".join(one): {key: value for each in one.values() for key, value in each.items()} for one in found}
