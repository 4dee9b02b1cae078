"""What tests of several parts share."""

from tests.certificates import certificate
from tests.vehicle_fixtures import boat, counted, make_boat

__all__ = ["boat", "certificate", "counted", "make_boat"]
