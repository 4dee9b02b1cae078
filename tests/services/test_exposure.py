"""The doors of a boat: who gets in by which, what one can do there, and which of them keep the boat from the sea."""

import re
import tomllib
from typing import Any

import pytest

from delfim import config
from delfim.base.tables import decode
from delfim.services.access.connection_limits import hashed
from delfim.services.access.exposure import SERVICES, doors, unheard

KEY, LAN = "/etc/delfim/key", "192.168.5.10:80"
TABLET, TOLD = {"listen": "0.0.0.0:8765"}, {"peers": ["127.0.0.1:14561"]}
# A service and values of the vehicle's file; below, its doors: place | reach | who | may | what keeps the boat from the sea.
DOORS = """
vehicle
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
vehicle  simulation.faults=true
    /run/delfim/command | here | programs of this computer that may open the file | command the boat | simulation.faults
        lets `delfim fault` break the boat's log and links
mavlink
    127.0.0.1:14555 UDP | here | every program of this computer, for there is no key | command the boat
mavlink  mavlink.key="/etc/delfim/key"
    127.0.0.1:14555 UDP | known | holders of /etc/delfim/key | watch and command the boat
mavlink  mavlink.key="/etc/delfim/key"  mavlink.serial="/dev/radio"
    127.0.0.1:14555 UDP | known | holders of /etc/delfim/key | watch and command the boat
    /dev/radio | known | holders of /etc/delfim/key | watch and command the boat
mavlink  mavlink.enabled=false
mavlink  mavlink.enabled=false  mavlink.key="/etc/delfim/key"
guest
guest  guest.enabled=true
    127.0.0.1:4747 | here | every program of this computer, for there is no key | be the guest computer, which steers in
        mode grex
guest  guest.enabled=true  guest.key="/etc/delfim/key"  guest.networks=["10.0.0.0/8", "10.1.0.0/16"]
    127.0.0.1:4747 | known | holders of /etc/delfim/key in 10.0.0.0/8, 10.1.0.0/16 | be the guest computer, which steers
        in mode grex
guest  guest.enabled=false  guest.key="/etc/delfim/key"
guest  guest.enabled=true  guest.key="/etc/delfim/key"  guest.networks=[]
    127.0.0.1:4747 | known | holders of /etc/delfim/key in no network | be the guest computer, which steers in mode grex
cantcpd
    127.0.0.1:29536 | here | every program of this computer | read the buses
cantcpd  cantcpd.transmit=["127.0.0.0/8"]
    127.0.0.1:29536 | here | every program of this computer | read the buses and send frames
cantcpd  cantcpd.listen=["192.168.5.10:80"]  cantcpd.slcan=["127.0.0.1:3"]  cantcpd.watch=["0.0.0.0/0"]
    192.168.5.10:80 | anyone | anyone in 0.0.0.0/0 | read the buses
    127.0.0.1:3 | here | every program of this computer | read the buses
cantcpd  cantcpd.listen=["192.168.5.10:80"]  cantcpd.transmit=["0.0.0.0/0"]
    192.168.5.10:80 | here | every program of this computer | read the buses and send frames
cantcpd  cantcpd.listen=["192.168.5.10:80"]  cantcpd.watch=["127.0.0.0/8", "10.0.0.0/8"]
    & cantcpd.transmit=["10.0.0.7/32", "127.0.0.0/8"]
    192.168.5.10:80 | anyone | anyone in 10.0.0.0/8 | read the buses and send frames | cantcpd.transmit: anyone in
        10.0.0.7/32 may send frames, which move the boat
cantcpd  cantcpd.listen=["192.168.5.10:80"]  cantcpd.watch=["10.0.0.0/8"]  cantcpd.transmit=["127.0.0.0/8"]
    192.168.5.10:80 | anyone | anyone in 10.0.0.0/8 | read the buses
httpd
    127.0.0.1:8080 | here | every program of this computer | read the boat's page and its logs
httpd  httpd.listen="192.168.5.10:80"
    192.168.5.10:80 | anyone | anyone who reaches this address | read the boat's page and its logs
tabletd  mavlink.peers=["127.0.0.1:14561"]  tablet.listen="0.0.0.0:8765"  tablet.certificate="/etc/cert"
    0.0.0.0:8765 | known | holders of the token or of an operator's key in /log/.tablet, over TLS | watch and command the
        boat
tabletd  mavlink.peers=["127.0.0.1:14561"]  tablet.listen="0.0.0.0:8765"
    0.0.0.0:8765 | known | holders of the token or of an operator's key in /log/.tablet, in the clear | watch and command
        the boat | tabletd: whoever hears the token commands the boat; name a certificate (tablet.certificate)
tabletd  mavlink.peers=["127.0.0.1:14561"]  tablet.listen="127.0.0.1:8765"
    127.0.0.1:8765 | here | holders of the token or of an operator's key in /log/.tablet | watch and command the boat
slipd  slipd.device="/dev/radio"
    /dev/radio, 10.0.0.1 | anyone | anyone with such a radio on its frequency | reach the doors of this list
canip
    canip0, 192.168.1.2/24 | anyone | nodes of the bus | reach the UDP doors of this list
ftpd
    127.0.0.1:2121 | known | , by password, in the clear | read /log
ftpd  ftpd.listen="192.168.5.10:80"
    & ftpd.users={ana = {password = "{SECRET}"}, rui = {password = "{SECRET}", upload = true}}
    192.168.5.10:80 | known | ana, rui, by password, in the clear | read /log; upload: rui | ftpd: whoever hears a
        password may upload; name a certificate (ftpd.certificate)
ftpd  ftpd.listen="192.168.5.10:80"
    & ftpd.users={ana = {password = "{SECRET}"}}
    192.168.5.10:80 | known | ana, by password, in the clear | read /log
ftpd  ftpd.listen="192.168.5.10:80"  ftpd.certificate="/etc/cert"
    & ftpd.users={rui = {password = "{SECRET}", upload = true}}
    192.168.5.10:80 | known | rui, by password, over TLS | read /log; upload: rui
ftpd  ftpd.users={rui = {password = "{SECRET}", upload = true}}
    127.0.0.1:2121 | known | rui, by password, in the clear | read /log; upload: rui
sshd
    127.0.0.1:2222 | known | , by key | run programs as the user that started Delfim, read and write files
sshd  sshd.user="sailor"
    127.0.0.1:2222 | known | , by key | run programs as sailor, read and write files
fleetd  mavlink.key="/etc/delfim/key"  mavlink.peers=["127.0.0.1:14560"]  fleet.broker="mqtts://shore:8883/fleet"
    mqtts://shore:8883/fleet, state | anyone | anyone who may read at the broker | read where the boat is
    mqtts://shore:8883/fleet | known | holders of /etc/delfim/key, through the broker | watch and command the boat
    127.0.0.1:14560 UDP | here | every program of this computer | send bytes to the broker; without the key they say
        nothing
fleetd  mavlink.key="/etc/delfim/key"  mavlink.peers=["127.0.0.1:14560"]  fleet.broker="mqtts://shore:8883/fleet"
    & fleet.credentials="/etc/mqtt"
    mqtts://shore:8883/fleet, state | anyone | the broker knows who may read it | read where the boat is
    mqtts://shore:8883/fleet | known | holders of /etc/delfim/key, through the broker | watch and command the boat
    127.0.0.1:14560 UDP | here | every program of this computer | send bytes to the broker; without the key they say
        nothing
rosd  ros.router="tcp/r:7447"
    tcp/r:7447 | anyone | anyone who reaches this Zenoh router | read the boat's state
rosd  ros.router="tcp/127.0.0.1:7447"  ros.commands=true  guest.enabled=true
    tcp/127.0.0.1:7447 | anyone | anyone who reaches this Zenoh router | read the boat's state; be the guest computer,
        which steers in mode grex
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="udp:0.0.0.0:9"  nmea0183.senders=["127.0.0.0/8"]
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
    0.0.0.0:9 UDP | here | every program of this computer | tell the boat where it is
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="udp:0.0.0.0:9"
    & nmea0183.senders=["10.0.0.7/32", "127.0.0.0/8"]
    0.0.0.0:9 UDP | anyone | anyone with an address in 10.0.0.7/32 | tell the boat where it is
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="udp:0.0.0.0:9"
    & nmea0183.senders=["10.0.0.7/32", "10.0.1.0/31"]
    0.0.0.0:9 UDP | anyone | anyone with an address in 10.0.0.7/32, 10.0.1.0/31 | tell the boat where it is |
        nmea0183.senders: anyone in 10.0.1.0/31 may tell the boat where it is, by nmea0183.ports.gnss.device; name single
        addresses
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="udp:127.0.0.1:9"  nmea0183.senders=["10.0.1.0/31"]
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
    127.0.0.1:9 UDP | here | every program of this computer | tell the boat where it is
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="tcp-listen:0.0.0.0:9"
    & nmea0183.senders=["10.0.1.0/31"]
    0.0.0.0:9 | anyone | anyone with an address in 10.0.1.0/31 | tell the boat where it is | nmea0183.senders: anyone in
        10.0.1.0/31 may tell the boat where it is, by nmea0183.ports.gnss.device; name single addresses
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
vehicle  navigation.sources=["nmea0183"]  nmea0183.ports.gnss.device="/dev/ttyS0"  nmea0183.senders=["10.0.1.0/31"]
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
vehicle  nmea0183.guest.device="udp:127.0.0.1:9"
    /run/delfim/command | here | programs of this computer that may open the file | command the boat
    127.0.0.1:9 UDP | here | every program of this computer | be the guest computer, which steers in mode grex
"""


def boat(**tables: Any) -> config.Vehicle:
    return decode({"boat": {"name": "test"}} | tables, config.Vehicle, "test.toml")


@pytest.mark.parametrize("row", re.split(r"\n(?=\S)", DOORS.strip()))
def test_a_door(row: str) -> None:
    head, *told = re.sub(r"\n(?:    & |        )", lambda m: "  " if "&" in m[0] else " ", row).split("\n    ")
    service, *values = head.replace("{SECRET}", hashed("sesame", b"salt")).split("  ")
    found = [tuple(each)[1:] for each in doors(boat(**tomllib.loads("\n".join(values))), [service]) if each.service == service]
    assert found == [tuple((each + " | " * (4 - each.count(" | "))).split(" | ")) for each in told]


def test_doors_of_anyone_come_first_and_services_that_do_not_run_have_none() -> None:
    program = {"command": ["/bin/true"], "may": ["hold", "goto"]}
    programs = {"uphill": program, "mute": {"command": ["/bin/true"]}}
    settings = boat(httpd={"listen": LAN}, guest={"enabled": True}, tablet=TABLET, mavlink=TOLD, payload=programs)
    running = {*SERVICES, "rosd", "fleetd", "payload"}
    rows = [(each.service, each.reach) for each in doors(settings, running)]
    assert [reach for _, reach in rows] == sorted((reach for _, reach in rows), key=("anyone", "known", "here").index)
    assert {service for service, _ in rows} == {"vehicle", "mavlink", "guest", *running}
    steers = [(each.place, each.reach, each.who, each.may) for each in doors(settings, running) if each.service == "payload"]
    assert steers == [("/bin/true", "here", "payload uphill, when an operator gave it the boat", "order: hold, goto")]
    assert {each.service for each in doors(settings, ["httpd"])} == {"vehicle", "mavlink", "guest", "httpd"}


@pytest.mark.parametrize(
    ("mavlink", "fleet", "why"),
    [
        ({"enabled": False, "key": KEY}, {}, "mavlink.enabled is false"),
        ({}, {}, "mavlink.key is empty, and without a key only this computer is heard"),
        ({"key": KEY}, {}, "mavlink.listen is 127.0.0.1:14555, which only this computer reaches"),
        ({"key": KEY, "listen": "0.0.0.0:14555"}, {}, ""),
        ({"key": KEY, "serial": "/dev/radio"}, {}, ""),
        ({"key": KEY, "peers": ["127.0.0.1:14560"]}, {"broker": "mqtts://shore:8883/fleet"}, ""),
    ],
)
def test_why_no_console_reaches_the_boat(mavlink: dict[str, Any], fleet: dict[str, Any], why: str) -> None:
    assert unheard(boat(mavlink=mavlink, fleet=fleet)) == why
