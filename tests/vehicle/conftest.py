"""The boat that these tests sail."""

from tests.vehicle_fixtures import boat, counted, make_boat

__all__ = ["boat", "counted", "make_boat"]
