"""The exact forces of thrusters within their limits, whatever is asked for (`allocation.py` has the problem).

The dual problem has three unknowns l = Q (t - B f), however many thrusters there are: f = clip(w b'l). It is concave and
piecewise quadratic, so that Newton's method with an exact search along its direction ends after a few steps.
"""

from typing import Final

WEIGHTS: Final = 1.0, 1.0, 3000.0  # surge, sway, yaw; the moment in units of the strongest thruster at the longest arm
STEPS: Final = 40  # of Newton's method, at most
CLOSE: Final = 1e-14  # square of a request that is not met, in units of the strongest thruster

Column = tuple[
    float, float, float, float, float, float, float, float, float
]  # surge, sway, yaw of a unit of force; times w; low, high, w
Force = tuple[float, float, float]  # surge N, sway N, yaw N m
Symmetric = tuple[float, float, float, float, float, float]  # 11, 12, 13, 22, 23, 33 of a symmetric matrix


def hessian(columns: list[Column]) -> Symmetric:
    """Of the dual, while no limit is in the way."""
    xx, xy, xn, yy, yn, nn = 1.0 / WEIGHTS[0], 0.0, 0.0, 1.0 / WEIGHTS[1], 0.0, 1.0 / WEIGHTS[2]
    for x, y, n, wx, wy, wn, _, _, _ in columns:
        xx += wx * x
        xy += wx * y
        xn += wx * n
        yy += wy * y
        yn += wy * n
        nn += wn * n
    return xx, xy, xn, yy, yn, nn


def inverse(matrix: Symmetric) -> Symmetric:
    a, b, c, d, e, f = matrix
    aa, ab, ac = d * f - e * e, c * e - b * f, b * e - c * d
    whole = a * aa + b * ab + c * ac
    return aa / whole, ab / whole, ac / whole, (a * f - c * c) / whole, (b * c - a * e) / whole, (a * d - b * b) / whole


def times(matrix: Symmetric, x: float, y: float, n: float) -> Force:
    a, b, c, d, e, f = matrix
    return a * x + b * y + c * n, b * x + d * y + e * n, c * x + e * y + f * n


def solved(columns: list[Column], tx: float, ty: float, tn: float, x: float, y: float, n: float) -> list[float]:
    """The forces for a request (tx, ty, tn), by Newton's method on the dual from (x, y, n)."""
    qx, qy, qn = 1.0 / WEIGHTS[0], 1.0 / WEIGHTS[1], 1.0 / WEIGHTS[2]
    for _ in range(STEPS):
        xx, xy, xn, yy, yn, nn = qx, 0.0, 0.0, qy, 0.0, qn
        gx, gy, gn = tx - qx * x, ty - qy * y, tn - qn * n
        forces: list[float] = []  # not list[float](), which takes ten times as long
        asked: list[float] = []
        for bx, by, bn, wx, wy, wn, low, high, _ in columns:
            ask = f = wx * x + wy * y + wn * n
            if f < low:
                f = low
            elif f > high:
                f = high
            else:
                xx += wx * bx
                xy += wx * by
                xn += wx * bn
                yy += wy * by
                yn += wy * bn
                nn += wn * bn
            asked.append(ask)
            forces.append(f)
            gx -= bx * f
            gy -= by * f
            gn -= bn * f
        if gx * gx + gy * gy + gn * gn < CLOSE:
            break
        ratio_y, ratio_n = xy / xx, xn / xx  # Gauss, for the symmetric matrix of what is not at a limit
        pivot_y, mixed = yy - ratio_y * xy, yn - ratio_y * xn
        ratio = mixed / pivot_y
        right_y = gy - ratio_y * gx
        dn = (gn - ratio_n * gx - ratio * right_y) / (nn - ratio_n * xn - ratio * mixed)
        dy = (right_y - mixed * dn) / pivot_y
        dx = (gx - xy * dy - xn * dn) / xx
        far = _far(columns, asked, dx, dy, dn, gx * dx + gy * dy + gn * dn, qx * dx * dx + qy * dy * dy + qn * dn * dn)
        x += far * dx
        y += far * dy
        n += far * dn
    return forces


def _far(columns: list[Column], asked: list[float], dx: float, dy: float, dn: float, slope: float, bend: float) -> float:
    """How far the dual rises along a direction, exactly: its slope falls in straight pieces, whose bends are where a thruster
    comes to a limit or leaves it. `slope` here; `bend` of the part that has no limits."""
    ends = list[tuple[float, float]]()
    for (_, _, _, wx, wy, wn, low, high, w), at in zip(columns, asked, strict=True):
        change = wx * dx + wy * dy + wn * dn
        if not change:
            continue
        first, last = (low - at) / change, (high - at) / change
        if first > last:
            first, last = last, first
        if last <= 0.0:
            continue
        own = change * change / w
        if first > 0.0:
            ends.append((first, own))
        else:
            bend += own
        ends.append((last, -own))
    ends.sort()
    here = 0.0
    for end, change in ends:
        fall = bend * (end - here)
        if fall >= slope:
            break
        slope -= fall
        here = end
        bend += change
    return here + slope / bend
