"""The two plants and the network of Chapter 7, for the tests of this folder."""

import numpy as np
import scipy.linalg

LAMBDA = np.array([[0.6, 0.4, 0.0], [0.7, 0.2, 0.1], [0.8, 0.1, 0.1]])
PI = np.array([[0.5, 0.5], [0.7, 0.3]])


def zero_order_hold(A, B, period_s):
    n, m = B.shape
    block = scipy.linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period_s)
    return block[:n, :n], block[:n, n:]


MOTOR_CONTINUOUS = (np.array([[0.0, 1.0], [0.0, -3.5287]]), np.array([[0.0], [172.38]]))
MOTOR = (*zero_order_hold(*MOTOR_CONTINUOUS, 0.05), np.array([[1.0, 0.0]]))
VTOL = (
    np.array([[0.9996, 0.0003, 0.0002, -0.0046], [0.0005, 0.99, -0.0002, -0.04],
              [0.001, 0.0036, 0.993, 0.0141], [0.0, 0.0, 0.01, 1.0001]]),
    np.array([[0.0044, 0.0018], [0.0353, -0.0755], [-0.0549, 0.0446], [-0.0003, 0.0002]]),
    np.array([[0.0, 1.0, 0.0, 0.0]]),
)  # fmt: skip
VTOL_R = np.array([0.01, 0.01])
PRINTED_HINF = np.array([[-0.1576, -0.1318], [-0.0878, 0.0091], [-0.0342, 0.0074]]).reshape(3, 2, 1, 1)
PRINTED_H2 = np.array([[-0.1980, -0.1647], [-0.1232, -0.0547], [-0.0747, -0.0399]]).reshape(3, 2, 1, 1)
PRINTED_VTOL_H2 = np.array(
    [[[-4.1629, 5.6465], [-4.1774, 5.6462]], [[-1.8548, 2.5818], [-1.1025, 1.5065]],
     [[-1.3368, 1.8751], [-1.0764, 1.4867]]]
)[..., None]  # fmt: skip
PRINTED_VTOL_HINF = np.array(
    [[[-5.6786, 7.4750], [-6.5506, 8.7246]], [[-1.8669, 2.5136], [-1.2499, 1.6792]],
     [[-1.0491, 1.4216], [-0.9730, 1.3288]]]
)[..., None]  # fmt: skip
