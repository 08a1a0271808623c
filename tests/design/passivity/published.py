"""The published numbers of Section 6.5 that several tests need."""

import numpy as np

from design.passivity import HeldDevice

PERIOD_S = 0.05
DAMPING = 1.9857
DEVICE = HeldDevice(mass_kg=0.7943, damping_n_s_per_m=DAMPING)
LAMBDA = np.array([[0.4, 0.3, 0.3], [0.3, 0.4, 0.3], [0.15, 0.15, 0.7]])
