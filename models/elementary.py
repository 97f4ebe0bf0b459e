"""Elementary functions without branches, which compile for numbers and for packs of numbers.

Instead of branching, both alternatives are computed and `where` selects one. The functions of the
C library take one number at a time; with packs (`packs.py`) they would dominate the computing time
of a step.
"""

from typing import Any

import numpy as np
from numba.core import types
from numba.extending import overload

from seatrial.models.compiled import LEAN, lean_kernel

PER_RADIAN = 0.6366197723675814  # 2 / pi
HALF_PI = (1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
S1, S2, S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
S4, S5, S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
C1, C2, C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
C4, C5, C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11
P0, P1, P2 = -8.750608600031904122785e-1, -1.615753718733365076637e1, -7.500855792314704667340e1
P3, P4 = -1.228866684490136173410e2, -6.485021904942025371773e1
Q1, Q2, Q3 = 2.485846490142306297962e1, 1.650270098316988542046e2, 4.328810604912902668951e2
Q4, Q5 = 4.853903996359136964868e2, 1.945506571482613964425e2
STEEP = 0.66  # above this slope the angle is measured from 45 degrees
QUARTER_PI, QUARTER_REST = 0.78539816339744830962, 3.0616169978683829e-17


def where(mask: Any, a: Any, b: Any) -> Any:
    """`a` where the mask is true, else `b`; both are evaluated."""
    return a if mask else b


overload(where, jit_options=LEAN)(
    lambda mask, a, b: (lambda mask, a, b: a if mask else b) if mask == types.boolean else None
)


@lean_kernel
def cosine_and_sine(x: float) -> tuple[float, float]:
    """cos(x) and sin(x), x [rad], |x| < 1.6e6, within 2e-16; NaN where x is not finite.

    The angle is reduced to r = x - n pi / 2, |r| <= pi / 4, with pi / 2 in three parts of which
    the first has 33 bits, so that n times it is exact for n < 2^20 (Cody and Waite). The
    polynomials are those of `k_sin.c` and `k_cos.c` in Sun's fdlibm 5.3.
    """
    n = np.floor(x * PER_RADIAN + 0.5)
    r = ((x - n * HALF_PI[0]) - n * HALF_PI[1]) - n * HALF_PI[2]
    z = r * r
    odd = S1 + z * (S2 + z * (S3 + z * (S4 + z * (S5 + z * S6))))
    even = C1 + z * (C2 + z * (C3 + z * (C4 + z * (C5 + z * C6))))
    sine, cosine = r + r * z * odd, 1.0 - (0.5 * z - z * z * even)
    quarter = n - 4.0 * np.floor(0.25 * n)
    crossed = quarter - 2.0 * np.floor(0.5 * quarter) == 1.0
    ahead, aside = where(crossed, sine, cosine), where(crossed, cosine, sine)
    ahead = where(abs(quarter - 1.5) < 1.0, -ahead, ahead)
    return ahead, where(quarter >= 2.0, -aside, aside)


@lean_kernel
def angle_of(y: float, x: float) -> float:
    """Angle [rad] of the vector (x, y) in [-pi, pi], within 3e-16; 0 for the vector (0, 0).

    The rational approximation of the arctangent is that of `atan.c` in Moshier's Cephes 2.8.
    """
    opposite, adjacent = abs(y), abs(x)
    over = opposite > adjacent
    longer = where(over, opposite, adjacent)
    slope = where(over, adjacent, opposite) / where(longer > 0.0, longer, 1.0)
    steep = slope > STEEP
    t = where(steep, (slope - 1.0) / (slope + 1.0), slope)
    z = t * t
    above = (((P0 * z + P1) * z + P2) * z + P3) * z + P4
    below = ((((z + Q1) * z + Q2) * z + Q3) * z + Q4) * z + Q5
    angle = t * (z * above / below) + t
    angle = where(steep, QUARTER_PI + (angle + QUARTER_REST), angle)
    angle = where(over, 2.0 * QUARTER_PI - (angle - 2.0 * QUARTER_REST), angle)
    angle = where(x < 0.0, 4.0 * QUARTER_PI - (angle - 4.0 * QUARTER_REST), angle)
    return where(y < 0.0, -angle, angle)  # type: ignore[no-any-return]
