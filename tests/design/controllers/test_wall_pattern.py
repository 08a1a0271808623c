"""The published Lambda from geometry, how far the law holds, and that real sliding has a memory."""

import numpy as np
import pytest
from scipy.stats import chi2

from design.controllers.wall_pattern import (
    Patch,
    Pattern,
    boundaries,
    material_chain,
    memory_statistic,
    paced_chain,
    square_rows,
    true_chain,
)
from tests.design.passivity.published import LAMBDA


def test_published_lambda_from_the_geometry():
    lengths, areas = boundaries(square_rows(0.02), 3)
    assert lengths == pytest.approx(0.04 * (1 - np.eye(3)))
    assert areas == pytest.approx([4e-4, 4e-4, 8e-4])
    found = material_chain(square_rows(0.02), 3, 0.15 * np.pi * 0.02)
    assert np.abs(found - LAMBDA).max() < 1e-12
    assert areas / areas.sum() @ LAMBDA == pytest.approx(areas / areas.sum(), abs=1e-12)  # area share is stationary


def test_the_law_holds_for_short_steps_only():
    """At 0.05 w within 6 %; at the published 0.4712 w the true matrix has 0.230 where Lambda has 0.3 (ERRATA 24)."""
    pattern, off = square_rows(1.0), ~np.eye(3, dtype=bool)
    short = true_chain(pattern, 3, 0.05)
    assert short[off] == pytest.approx(material_chain(pattern, 3, 0.05)[off], rel=0.06)
    long = true_chain(pattern, 3, 0.15 * np.pi)
    assert long == pytest.approx(np.array([[0.470, 0.230, 0.300], [0.230, 0.470, 0.300], [0.150, 0.150, 0.700]]), abs=4e-3)


@pytest.mark.slow
def test_isotropic_placement_gives_the_law_within_its_confidence_interval():
    """Two-sided at 1e-3 over 9 entries, 400,000 independent moves of 0.02 w: an error of 2 % of a rate would be seen."""
    pattern, step, count = square_rows(1.0), 0.02, 400_000
    find = pattern.finder()
    rng = np.random.default_rng(6)
    place, angle = rng.uniform(0, 2, (count, 2)), rng.uniform(0, 2 * np.pi, count)
    moved = place + step * np.column_stack([np.cos(angle), np.sin(angle)])
    here, there = (np.array([find(*p) for p in points.tolist()]) for points in (place[:120_000], moved[:120_000]))
    expected = material_chain(pattern, 3, step)
    for i in range(3):
        row = there[here == i]
        for j in range(3):
            share, p = float(np.mean(row == j)), expected[i, j]
            assert abs(share - p) <= 3.9 * np.sqrt(p * (1 - p) / row.size) + 0.06 * p * (i != j) * 0.05


def test_sliding_remembers_and_a_chain_does_not():
    """G over 12 degrees of freedom; level 1e-3. A chain passes, a straight line over the pattern does not."""
    rng = np.random.default_rng(3)
    path = [0]
    for u in rng.random(20_000):
        path.append(int(np.searchsorted(np.cumsum(LAMBDA[path[-1]]), u)))
    statistic, freedom = memory_statistic(path, 3)
    assert freedom == 12
    assert statistic < chi2.isf(1e-3, freedom)
    find = square_rows(0.02).finder()
    t = np.arange(20_000) * 0.15 * np.pi * 0.02
    line = [find(0.8 * s, 0.6 * s) for s in t.tolist()]
    assert memory_statistic(line, 3)[0] > 10 * chi2.isf(1e-3, freedom)


def test_faces_that_do_not_touch_give_zero():
    """Remark 6.2: strips in the order 0, 1, 0, 2 leave lambda_12 = 0 between materials 1 and 2."""
    strips = Pattern(width_m=1.0, height_m=4.0, patches=tuple(Patch(y_m=0.0, z_m=float(i), width_m=1.0, height_m=1.0, material=m)
                                                               for i, m in enumerate((0, 1, 0, 2))))  # fmt: skip
    found = material_chain(strips, 3, 0.1)
    assert found[1, 2] == found[2, 1] == 0.0 and found[1, 0] > 0.0


def test_too_long_a_step_and_a_missing_material_are_refused():
    with pytest.raises(ValueError, match="step_m: "):
        material_chain(square_rows(0.02), 3, 0.04)
    with pytest.raises(ValueError, match="material 3 has no area"):
        material_chain(square_rows(0.02), 4, 0.001)
    with pytest.raises(ValueError, match=r"patches\[2\]\.material: 2, but the wall has 2"):
        material_chain(square_rows(0.02), 2, 0.001)


def test_a_speed_that_varies_as_a_semi_markov_process_has_the_stays_that_it_was_given():
    """The share of time at a speed is its mean stay; at one speed for every pace the material is the chain of that speed."""
    pattern, step = square_rows(0.02), 0.003
    stays = [[0.0, 0.5, 0.5], [1.0], [0.2, 0.0, 0.0, 0.8]]
    chain, material = paced_chain(pattern, 3, [step, step, step], stays)
    assert chain.shape == (24, 24) and chain.sum(axis=1) == pytest.approx(np.ones(24))
    law = np.linalg.matrix_power(chain, 4096)[0]
    lengths, means = [3, 1, 4], [2.5, 1.0, 3.4]
    at = np.repeat(range(3), [3 * n for n in lengths])
    assert [law[at == s].sum() for s in range(3)] == pytest.approx(np.array(means) / sum(means), rel=1e-9)
    merged = np.array([[chain[i, np.array(material) == j].sum() for j in range(3)] for i in range(24)])
    assert merged == pytest.approx(material_chain(pattern, 3, step)[material], abs=1e-12)
    two, _ = paced_chain(pattern, 3, [step, 0.0], [[0.0, 1.0], [1.0]])
    assert two[0, 3] == material_chain(pattern, 3, step)[0, 0] and two[3, 6:].sum() == pytest.approx(1.0)
    assert two[6, :3].tolist() == [1.0, 0.0, 0.0], "at rest the material stays"


@pytest.mark.parametrize(
    ("steps", "stays", "message"),
    [
        ([0.1, 0.1], [[1.0], [0.5]], r"stays\[1\]: \[0.5\], expected probabilities"),
        ([0.1], [[1.0]], "stays: 1 laws and 1 speeds"),
        ([0.1, 0.1], [[1.0]], "stays: 1 laws and 2 speeds"),
    ],
)
def test_stays_that_are_no_laws_are_refused(steps, stays, message):
    with pytest.raises(ValueError, match=f"^{message}"):
        paced_chain(square_rows(0.02), 3, steps, stays)
