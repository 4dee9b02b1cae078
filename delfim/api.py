"""All that a laboratory's own part needs of Delfim (docs/own-parts.md). The names here stay as they are while `parts.API` does;
everything else in the project may change from one version to the next.
"""

from delfim.base.clock import Clock
from delfim.base.errors import BusError, ConfigError, DelfimError, FormatError, PermanentFailure
from delfim.base.frames import Frame, extended, standard
from delfim.base.geodesy import from_plane
from delfim.base.parts import API, Drives, ModeRow, OrderRow, Part, TroubleRow
from delfim.base.ranges import Baud, Device, Fraction, Interface, Metres, Seconds, Speed
from delfim.base.tables import Table, text
from delfim.canproxy.dsor.messages import Navigation
from delfim.canproxy.socket import CanAddress, CanSocket
from delfim.config import ActionName, Silence, Trouble, Vehicle
from delfim.vehicle.console import Continue, Course, Goto, Heading, Pause, Play, SetMode, SetSpeed, Stop
from delfim.vehicle.control.autopilot import entered, steer
from delfim.vehicle.control.control import Program
from delfim.vehicle.control.memory import Memory, Settings
from delfim.vehicle.failsafe.troubles import Look
from delfim.vehicle.foreign import OrderAsked
from delfim.vehicle.links import Links, LoopInput, ReadableLine
from delfim.vehicle.navigation.fixes import Fix, Source
from delfim.vehicle.propulsion.actuators import Actuator
from delfim.vehicle.sensors import Value
from delfim.vehicle.state import Actuation, Motion, Reference, Setpoint, State, ThrusterReport, Wanted

__all__ = [
    "API",
    "ActionName",
    "Actuation",
    "Actuator",
    "Baud",
    "BusError",
    "CanAddress",
    "CanSocket",
    "Clock",
    "ConfigError",
    "Continue",
    "Course",
    "DelfimError",
    "Device",
    "Drives",
    "Fix",
    "FormatError",
    "Fraction",
    "Frame",
    "Goto",
    "Heading",
    "Interface",
    "Links",
    "Look",
    "LoopInput",
    "Memory",
    "Metres",
    "ModeRow",
    "Motion",
    "Navigation",
    "OrderAsked",
    "OrderRow",
    "Part",
    "Pause",
    "PermanentFailure",
    "Play",
    "Program",
    "ReadableLine",
    "Reference",
    "Seconds",
    "SetMode",
    "SetSpeed",
    "Setpoint",
    "Settings",
    "Silence",
    "Source",
    "Speed",
    "State",
    "Stop",
    "Table",
    "ThrusterReport",
    "Trouble",
    "TroubleRow",
    "Value",
    "Vehicle",
    "Wanted",
    "entered",
    "extended",
    "from_plane",
    "standard",
    "steer",
    "text",
]
