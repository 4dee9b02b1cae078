"""A service that tells how high the water is: its row and its keys."""

from delfim.api import Part, Seconds, Table


class TidesTable(Table, frozen=True):
    """A tide gauge."""

    period_s: Seconds = 1.0  # between two readings


PART = Part("example_service", TidesTable, service="example_service.service:serve")
