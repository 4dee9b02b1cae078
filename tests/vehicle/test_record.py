"""The state log's rows: every one can be packed, at start and under way."""

import math
import struct

from delfim import config
from delfim.vehicle import console
from delfim.vehicle.log import record

RECORD = record.of(config.Vehicle(boat=config.BoatTable(name="test")))
FIELDS = RECORD.fields
PACKER = struct.Struct("<" + "".join(field.code for field in FIELDS))


def test_names_are_unique_and_every_field_is_explained():
    assert len({field.name for field in FIELDS}) == len(FIELDS)
    assert all(field.description for field in FIELDS)


def test_an_empty_state_is_recorded_as_unknown(boat):
    values = dict(zip((f.name for f in FIELDS), record.values(RECORD, boat.state, 1.0), strict=True))
    assert math.isnan(values["latitude"])
    assert math.isnan(values["starboard_rpm_measured"])
    PACKER.pack(*values.values())


def test_a_sailing_state_is_recorded_in_full(boat):
    boat.ready()
    boat.vehicle.on_command(console.Heading(90.0, 1.0))
    boat.pass_time(2.0)
    values = dict(zip((f.name for f in FIELDS), record.values(RECORD, boat.state, 2.0), strict=True))
    PACKER.pack(*values.values())
    assert values["mode"] == 3
    assert values["port_rpm"] > values["starboard_rpm"]
    assert values["port_rpm"] == 1200 * values["port_command"]
    assert values["starboard_rpm_measured"] != values["port_rpm_measured"]
    assert values["starboard_charge"] == 0.9
