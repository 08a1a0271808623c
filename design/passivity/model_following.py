"""MJLS-LQG model following for a wall over a network: coupled Riccati equations over the materials, and a Kalman filter.

    minimise E sum (x - x_m)^2 + r (u + K_i x_m + B_i v_m)^2        (1 m^2 against r N^2)

It is a comparison: nearly as stiff as the wall itself for the hand that it counts on, and unstable for most other passive hands.

Reference: Chapter 6, (6.7); Costa, Fragoso and Marques, Discrete-Time Markov Jump Linear Systems, 2005, Chapter 4.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_discrete_are

from design.controllers.gain_rows import nested
from design.controllers.rendered_wall import LinearInContact
from design.controllers.virtual_wall import ModelFollowing
from design.controllers.wall import Material, Wall
from design.errors import DesignError
from design.passivity import Array, HeldDevice

MOST_STEPS = 20_000


def follow_wall(
    wall: Wall,
    device: HeldDevice,
    *,
    period_s: float,
    sc: int,
    ca: int,
    material_chain: npt.ArrayLike,
    force_weight: float = 1e-7,
    hand_step_n: float = 0.05,
    noise_m: float = 1e-5,
) -> ModelFollowing:
    """Return the gains for one hand and constant delays.

    Args:
        wall: materials, and where they lie.
        device: device and the hand that it counts on.
        period_s: T in s.
        sc, ca: delays n1, n2 in samples.
        material_chain: Lambda (N, N) over all materials.
        force_weight: r in m^2/N^2, above 0.
        hand_step_n: how much the force of the hand changes in a sample, standard deviation in N.
        noise_m: noise of the position, standard deviation in m.

    Raises:
        DesignError: the coupled Riccati equations do not converge.
    """
    A, B = device.discretise(period_s)
    A3, B3 = np.eye(3), np.append(B, 0.0)
    A3[:2] = np.column_stack([A, B])
    targets = np.array([
        np.column_stack(device.discretise(period_s, m.stiffness_n_per_m, m.damping_n_s_per_m)) for m in wall.materials
    ])  # fmt: skip
    feedback = _feedback(wall.materials, A3, B3, targets, ca, np.asarray(material_chain, dtype=np.float64), force_weight)
    gain = _filter(A3, sc, hand_step_n, noise_m)
    return ModelFollowing(
        wall=wall, plant=nested(A3), force=nested(B3), filter_gain=nested(gain), targets=nested(targets),
        feedback=nested(feedback),
    )  # fmt: skip


def _feedback(
    materials: tuple[Material, ...], A3: Array, B3: Array, targets: Array, ca: int, chain: Array, weight: float
) -> Array:
    n = 5 + ca
    cost = np.zeros((len(materials), n + 1, n + 1))  # of (state, u)
    A, B = np.zeros((len(materials), n, n)), np.zeros((n, 1))
    for i, m in enumerate(materials):
        A[i, :3, :3] = A3
        if ca:
            A[i, :3, 2 + ca] = B3
            A[i, range(4, 3 + ca), range(3, 2 + ca)] = 1.0
        A[i, -2:, -2:], A[i, -2:, 2] = targets[i][:, :2], targets[i][:, 2]
        apart, late = np.zeros(n + 1), np.zeros(n + 1)
        apart[0], apart[n - 2] = 1.0, -1.0
        late[n - 2 :] = m.stiffness_n_per_m, m.damping_n_s_per_m, 1.0
        cost[i] = np.outer(apart, apart) + weight * np.outer(late, late)
    if ca:
        B[3, 0] = 1.0
    else:
        B[:3, 0] = B3
    P, F = np.zeros((len(materials), n, n)), np.zeros((len(materials), n))
    for step in range(MOST_STEPS):
        after = np.einsum("ij,jkl->ikl", chain, P)
        new, before = np.empty_like(P), F.copy()
        for i in range(len(materials)):
            both = np.hstack([A[i], B])
            whole = cost[i] + both.T @ after[i] @ both
            F[i] = whole[n, :n] / whole[n, n]
            new[i] = whole[:n, :n] - np.outer(whole[:n, n], F[i])
        new = 0.5 * (new + new.transpose(0, 2, 1))
        P, change = new, float(np.abs(F - before).max())
        if step > n and change <= 1e-11 * float(np.abs(F).max()):  # P itself grows for ever with the square of a constant push
            return F
    raise DesignError(f"force_weight: {weight!r}; the coupled Riccati equations do not converge in {MOST_STEPS} steps")


def _filter(A3: Array, sc: int, hand_step_n: float, noise_m: float) -> Array:
    n = 3 + sc
    A, C, W = np.zeros((n, n)), np.zeros((1, n)), np.zeros((n, n))
    A[:3, :3] = A3
    if sc:
        A[3, 0] = 1.0
        A[range(4, n), range(3, n - 1)] = 1.0
    C[0, 0 if sc == 0 else n - 1] = 1.0
    W[2, 2] = hand_step_n**2
    W[0, 0] = W[1, 1] = 1e-16
    S = solve_discrete_are(A.T, C.T, W, np.array([[noise_m**2]]))
    return np.asarray((S @ C.T / (C @ S @ C.T + noise_m**2))[:, 0])


def contact_matrices(running: LinearInContact, device: HeldDevice, *, period_s: float, sc: int, ca: int, materials: int) -> Array:
    """Return (N, n, n): the loop in contact with each material, for any hand; the controller is asked, column by column.

    State: (x, v, x(k-1) .. x(k-n1), u(k-1) .. u(k-n2), controller).

    Args:
        running: the controller that runs.
        device: device and the hand that holds it.
        period_s: T in s.
        sc, ca: delays in samples.
        materials: N.
    """
    A2, B2 = device.discretise(period_s)
    own = 2 + sc + ca
    n = own + running.order
    out = np.zeros((materials, n, n))
    for i in range(materials):
        for column, unit in enumerate(np.eye(n)):
            position = unit[0] if sc == 0 else unit[1 + sc]
            force, state = running.linear(unit[own:], float(position), i)
            felt = force if ca == 0 else unit[1 + sc + ca]
            after = np.concatenate([
                A2 @ unit[:2] + B2 * felt, unit[:1][:sc], unit[2 : 1 + sc] if sc else [], [force][:ca],
                unit[2 + sc : 1 + sc + ca] if ca else [], state,
            ])  # fmt: skip
            out[i, :, column] = after
    return out
