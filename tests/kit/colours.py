"""Colours as eyes see them: contrast (WCAG 2.2), difference (CIEDE2000), and the sight of those who lack a kind of cone.

Sources: Sharma, Wu, Dalal, Color Research & Application 30, 2005 (its table is the test's); Machado, Oliveira, Fernandes, IEEE
TVCG 15, 2009 (severity 1.0); sRGB as in IEC 61966-2-1.
"""

import math
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

Values: TypeAlias = NDArray[np.float64]

SIGHTS: Final[dict[str, Values]] = {
    "all": np.eye(3),
    "no red cones": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "no green cones": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "no blue cones": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
_XYZ: Final = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
)
_WHITE: Final = np.array([0.95047, 1.0, 1.08883])


def rgba(words: str) -> Values:
    """Red, green, blue, opacity, 0 to 1, of `#rrggbb`, `rgb(…)` or `rgba(…)`."""
    if words.startswith("#"):
        wide = "".join(2 * each for each in words[1:]) if len(words) == 4 else words[1:]
        return np.array([*(int(wide[i : i + 2], 16) / 255 for i in (0, 2, 4)), 1.0])
    numbers = [float(each) for each in words[words.index("(") + 1 : -1].replace(",", " ").replace("/", " ").split()]
    return np.array([*(each / 255 for each in numbers[:3]), *(numbers[3:] or [1.0])])


def over(front: str, behind: str) -> str:
    """What is seen where a colour, which may be thin, lies over another."""
    a, b = rgba(front), rgba(behind)
    return "#" + "".join(f"{round(255 * (x * a[3] + y * (1 - a[3]))):02x}" for x, y in zip(a[:3], b[:3], strict=True))


def contrast(a: str, b: str) -> float:
    """1 to 21, of WCAG 2.2."""
    light, dark = sorted((float(_linear(each) @ _XYZ[1]) for each in (a, b)), reverse=True)
    return (light + 0.05) / (dark + 0.05)


def lab(colour: str, sight: str = "all") -> Values:
    """CIE L*a*b* for D65, to that sight."""
    x = _XYZ @ np.clip(SIGHTS[sight] @ _linear(colour), 0.0, 1.0) / _WHITE
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(one: Values, other: Values) -> float:
    """CIEDE2000 of two colours of L*a*b*: 2 is just seen side by side."""
    (l1, a1, b1), (l2, a2, b2) = ([float(each) for each in its] for its in (one, other))
    c7 = ((math.hypot(a1, b1) + math.hypot(a2, b2)) / 2) ** 7
    g = 1.5 - 0.5 * math.sqrt(c7 / (c7 + 25.0**7))
    c1, c2 = math.hypot(g * a1, b1), math.hypot(g * a2, b2)
    h1, h2 = math.atan2(b1, g * a1) % math.tau, math.atan2(b2, g * a2) % math.tau
    turned = math.remainder(h2 - h1, math.tau) if c1 * c2 else 0.0
    bright, dc, dh = l2 - l1, c2 - c1, 2 * math.sqrt(c1 * c2) * math.sin(turned / 2)
    middle, c, h = (l1 + l2) / 2, (c1 + c2) / 2, h1 + turned / 2 if c1 * c2 else h1 + h2
    h %= math.tau
    t = 1 - 0.17 * math.cos(h - math.pi / 6) + 0.24 * math.cos(2 * h) + 0.32 * math.cos(3 * h + math.radians(6))
    t -= 0.2 * math.cos(4 * h - math.radians(63))
    sl, sc, sh = 1 + 0.015 * (middle - 50) ** 2 / math.sqrt(20 + (middle - 50) ** 2), 1 + 0.045 * c, 1 + 0.015 * c * t
    warp = math.radians(60 * math.exp(-(((math.degrees(h) - 275) / 25) ** 2)))
    both = -2 * math.sqrt(c**7 / (c**7 + 25.0**7)) * math.sin(warp) * (dc / sc) * (dh / sh)
    return math.sqrt((bright / sl) ** 2 + (dc / sc) ** 2 + (dh / sh) ** 2 + both)


def _linear(colour: str) -> Values:
    x = rgba(colour)[:3]
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)
