"""Real spherical harmonics from SciPy's associated Legendre functions, an independent source."""

from math import factorial, pi, sqrt

import numpy as np
from scipy.special import lpmv


def harmonic(number: int, directions: np.ndarray) -> np.ndarray:
    """Basis function `number` of 3DGS and gsplat at unit directions [n 3].

    sqrt(2) Re Y_lm for m > 0 and sqrt(2) Im Y_l|m| for m < 0, with the Condon-Shortley phase,
    counted 0 0, 1 -1, 1 0, 1 1, 2 -2, ...
    """
    band = int(sqrt(number))
    order = number - band**2 - band
    x, y, z = directions.T
    m = abs(order)
    size = sqrt((2 * band + 1) / (4 * pi) * factorial(band - m) / factorial(band + m))
    azimuth = np.arctan2(y, x)
    turn = np.cos(m * azimuth) if order >= 0 else np.sin(m * azimuth)
    return size * lpmv(m, band, z) * turn * (sqrt(2) if order else 1)
