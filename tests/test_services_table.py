"""The table of services, and which rows of it a vehicle's file runs."""

from pathlib import Path

import pytest

from delfim import config
from delfim.errors import PermanentFailure
from delfim.suite import services

VEHICLE = Path(__file__).parents[1] / "etc" / "delfimx.toml"


def names(*overrides: str) -> list[str]:
    return [row.name for row in services(config.load(VEHICLE, overrides))]


def test_the_vehicle_starts_last_and_stops_first() -> None:
    assert names()[-1] == "vehicle"


@pytest.mark.parametrize(
    ("service", "override"), [("canip", "canip.enabled=true"), ("timed", 'timed.mode="redundant"'), ("logd", "logd.nodes=[1]")]
)
def test_some_services_run_only_where_their_own_table_asks_for_them(service: str, override: str) -> None:
    assert service not in names()
    assert service in names(override)
    assert service not in names(override, f"services.{service}.enabled=false")


def test_a_name_that_is_no_service_is_refused() -> None:
    with pytest.raises(PermanentFailure, match=r"services\.nonsense: there is no such service"):
        names('services.nonsense.place="process"')
