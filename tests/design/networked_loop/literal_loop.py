"""A second way to the closed loop: whole packets in the state, the delays of the last slots in the mode."""

from __future__ import annotations

import itertools

import numpy as np


def literal_radius(A, B, C, sc, ca, gains, selection):
    """Second-moment radius of the loop in which every packet under way is kept whole.

    State: x(k), the samples C x(k-1) .. C x(k-tau_max), the packets of slots k-1 .. k-d_max with all their rows.
    Mode: the S-C mode, and the C-A modes of slots k, k-1, .. k-d_max-1.
    """
    A, B, C, gains = (np.asarray(M, dtype=float) for M in (A, B, C, gains))
    n, m, p = len(A), B.shape[1], len(C)
    rows, depth, reach = gains.shape[1], sc.max_delay, ca.max_delay
    width = rows * m
    packets = n + depth * p
    order = packets + reach * width
    everything = itertools.product(range(ca.modes), repeat=reach + 2)
    histories = [h for h in everything if all(ca.matrix[b, a] > 0 for a, b in itertools.pairwise(h))]
    modes = [(s, h) for s in range(sc.modes) for h in histories]
    matrices = []
    for s, h in modes:
        tau, d = int(sc.delay[s]), int(ca.delay[h[0]])
        sample = np.zeros((p, order))
        if tau:
            sample[:, n + (tau - 1) * p : n + tau * p] = np.eye(p)
        else:
            sample[:, :n] = C
        packet = gains[int(sc.label[s])].reshape(width, p) @ sample
        at_generation, before = int(ca.label[h[d]]), int(ca.label[h[d + 1]])
        row = {"constant": 0, "generated": at_generation, "previous": before, "applied": int(ca.label[h[0]])}[selection]
        under_way = np.zeros((width, order))
        if d:
            under_way[:, packets + (d - 1) * width : packets + d * width] = np.eye(width)
        applied = (packet if d == 0 else under_way)[row * m : (row + 1) * m]
        M = np.zeros((order, order))
        M[:n, :n] = A
        M[:n] += B @ applied
        if depth:
            M[n : n + p, :n] = C
            M[n + p : packets, n : packets - p] = np.eye((depth - 1) * p)
        if reach:
            M[packets : packets + width] = packet
            M[packets + width :, packets : order - width] = np.eye((reach - 1) * width)
        matrices.append(M)
    blocks = [[None] * len(modes) for _ in modes]
    for i, (s, h) in enumerate(modes):
        square = np.kron(matrices[i], matrices[i])
        for j, (s2, h2) in enumerate(modes):
            p_ij = sc.matrix[s, s2] * ca.matrix[h[0], h2[0]] if h2[1:] == h[:-1] else 0.0
            blocks[j][i] = p_ij * square
    return float(np.abs(np.linalg.eigvals(np.block(blocks))).max())
