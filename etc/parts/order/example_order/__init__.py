"""A winch on a CAN bus, which the operator orders: its row, its keys, and those of its orders."""

from typing import Annotated

import msgspec

from delfim.api import Interface, OrderRow, Part, Speed, Table


class WinchTable(Table, frozen=True):
    """A winch on a CAN bus."""

    interface: Interface = "can2"  # its bus
    pays_out_below_mps: Speed = 1.0  # of the boat over ground: it lets out no rope of a boat that is faster


class PayOut(Table, frozen=True):
    """Let out rope, or haul it in, until so much is out."""

    rope_m: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 5.0  # that shall be out
    rate_mps: Annotated[float, msgspec.Meta(ge=0.1, le=1.0)] = 0.5  # of the rope


class Station(Table, frozen=True):
    """Hold here, with all rope hauled in."""


PART = Part(
    "example_order",
    WinchTable,
    sensor="example_order.winch",
    orders=(
        OrderRow("pay_out", PayOut, "example_order.winch:pay_out", number=31010),
        OrderRow("station", Station, "example_order.winch:station"),
    ),
    played="example_order.played",
)
