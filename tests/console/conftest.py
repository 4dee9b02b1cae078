"""The boat that these tests sail."""

from tests.vehicle_fixtures import boat, make_boat

__all__ = ["boat", "make_boat"]
