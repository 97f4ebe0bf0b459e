"""Sine and cosine that vectorise over the lanes of a block.

The library's are called one angle at a time, which took most of a step of a vessel that turns.
The angle is reduced to r = x - n pi / 2, |r| <= pi / 4, with pi / 2 in three parts of which the
first has 33 bits, so that n times it is exact for n < 2^20 (Cody and Waite). The polynomials are
those of `k_sin.c` and `k_cos.c` in Sun's fdlibm 5.3.
"""

import numpy as np

from seatrial.models.compiled import lean_kernel

PER_RADIAN = 0.6366197723675814  # 2 / pi
HALF_PI = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11


@lean_kernel
def cosine_and_sine(x: float) -> tuple[float, float]:
    """cos(x) and sin(x), x [rad], |x| < 1.6e6, within 2e-16; not a number where x is none."""
    n = np.floor(x * PER_RADIAN + 0.5)
    r = ((x - n * HALF_PI[0]) - n * HALF_PI[1]) - n * HALF_PI[2]
    z = r * r
    odd = S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6))))
    even = C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6))))
    sine, cosine = r + r * z * odd, 1.0 - (0.5 * z - z * z * even)
    quarter = n - 4.0 * np.floor(0.25 * n)
    crossed = quarter == 1.0 or quarter == 3.0
    ahead, aside = (sine, cosine) if crossed else (cosine, sine)
    ahead = -ahead if quarter == 1.0 or quarter == 2.0 else ahead
    aside = -aside if quarter >= 2.0 else aside
    return ahead, aside
