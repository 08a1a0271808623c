"""A real vcan0 on any machine: the parts of ``tests/with_vcan``, and the tests that need it.

``supervise`` runs a child that cannot outlive us, ``native`` and ``uml`` are the two kinds of place with
a vcan0, ``guest`` is what happens inside a user-mode kernel, ``kernel`` finds or builds one. Standard
library only: the runner must work before the project's ``.venv`` exists.
"""
