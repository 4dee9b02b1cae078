"""What several daemons' tests need."""

from tests.certificates import certificate

__all__ = ["certificate"]
