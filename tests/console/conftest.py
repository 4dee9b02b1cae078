"""What tests of the console share: the boat that they sail, and the page on two idle ones."""

import asyncio

import pytest

from tests.console.chain import Sea
from tests.kit.page import gateway, page
from tests.vehicle_fixtures import boat, make_boat

__all__ = ["boat", "gateway", "make_boat", "page"]


@pytest.fixture(scope="module")
def runner(afloat: tuple[asyncio.Runner, Sea]) -> asyncio.Runner:
    """What runs the coroutines of a file whose boats and browser are started once."""
    return afloat[0]
