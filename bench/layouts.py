"""Boats with three and four fixed thrusters for `bench.adoption` and the tests: boats of etc/boats with other rows."""

from typing import Final, NamedTuple

T200, SMALL, POD = (-39.9, 51.4), (-70.0, 70.0), (-100.0, 200.0)
Row = tuple[str, float, float, float, tuple[float, float]]  # name, x m, y m, angle deg, thrust N


class Layout(NamedTuple):
    """A boat of etc/boats, and the rows that it has instead of its own; empty: its own."""

    boat: str
    rows: tuple[Row, ...] = ()

    @property
    def told(self) -> tuple[str, ...]:
        """The keys that are laid over its file."""
        rows = (
            f'{{name="{name}",driver="pwm",address={at},x_m={x},y_m={y},angle_deg={angle},thrust_n=[{low},{high}]}}'
            for at, (name, x, y, angle, (low, high)) in enumerate(self.rows)
        )
        return (f"thrusters=[{','.join(rows)}]",) if self.rows else ()


def _pairs(x_m: float, y_m: float) -> tuple[Row, ...]:
    """A pair at each side, one behind the other."""
    return (
        ("bow_starboard", x_m, y_m, 0.0, T200),
        ("bow_port", x_m, -y_m, 0.0, T200),
        ("stern_starboard", -x_m, y_m, 0.0, T200),
        ("stern_port", -x_m, -y_m, 0.0, T200),
    )


LAYOUTS: Final = {
    "float": Layout("float"),  # four at its corners, across
    "pairs": Layout("otter", _pairs(0.5, 0.395)),
    "small pairs": Layout("blueboat", _pairs(0.35, 0.35)),  # with much power for their size
    "bow-thruster": Layout(  # two that push ahead, and one that pushes the bow aside
        "wam-v",
        (
            ("starboard", -2.4, 1.03, 0.0, (-100.0, 250.0)),
            ("port", -2.4, -1.03, 0.0, (-100.0, 250.0)),
            ("bow", 2.0, 0.0, 90.0, SMALL),
        ),
    ),
    "pods": Layout(  # four pods at the corners of a long boat, set across
        "wam-v",
        (
            ("bow_starboard", 1.6, 1.03, -45.0, POD),
            ("bow_port", 1.6, -1.03, 45.0, POD),
            ("stern_starboard", -2.2, 1.03, 45.0, POD),
            ("stern_port", -2.2, -1.03, -45.0, POD),
        ),
    ),
}
