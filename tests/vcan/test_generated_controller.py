"""The generated controller in C over real SocketCAN frames: what is applied is what our own controller applies, bit for bit."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.runtime.virtual import simulate
from tests.generated_controllers import asked_over, generate, runs
from tests.realtime.test_generated_controllers import EXACT, SEED, assert_same_run, loop_of

pytestmark = pytest.mark.vcan


@pytest.mark.parametrize("language", ["python", "c"])
@pytest.mark.parametrize("options", ["", "?fd=0"], ids=["fd", "classic"])
def test_it_applies_the_same_inputs_over_vcan0(tmp_path: Path, language: str, options: str) -> None:
    loop = loop_of("dc-motor-hinf", *EXACT, f"links.uri=can:socketcan:vcan0{options}")
    words = generate(tmp_path, loop, language)  # type: ignore[arg-type]
    with runs([*words, "vcan0", *(["socketcan"] if language == "python" else [])]):
        assert_same_run(asked_over(loop, SEED, f"can:socketcan:vcan0{options}"), simulate(loop, SEED))
