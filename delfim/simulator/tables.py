"""The keys of a vehicle's file that count in simulation alone."""

from typing import Annotated, Literal

import msgspec

from delfim.base.ranges import PORT, Endpoint, Fraction, Interface, Name
from delfim.base.tables import Table, text

Coefficient = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
InstrumentRate = Annotated[float, msgspec.Meta(ge=0.0, le=50.0)]
INSTRUMENTS = ("receiver", "compass", "gyro", "sounder", "wind", "ais")
InstrumentName = Annotated[
    str, text(rf"[A-Za-z][A-Za-z0-9_-]{{0,31}}:({'|'.join(INSTRUMENTS)})", f"PORT:INSTRUMENT, one of {', '.join(INSTRUMENTS)}")
]


class Sea(Table, frozen=True):
    """The simulator's weather. As sailors say it, wind is named by where it comes from, current by where it goes."""

    current_mps: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0  # speed of the current
    current_to_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # direction it sets
    wind_mps: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 0.0  # mean wind
    wind_from_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # direction it comes from
    gusts: Fraction = 0.2  # standard deviation of the wind, as a part of its mean


class SimulatedBed(Table, frozen=True):
    """The bottom of the simulated sea, which its sounders find (docs/simulator.md). Without it there are 12 m of water."""

    mean_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.0  # depth that it rises and falls about; 0: it is flat
    seed: Annotated[int, msgspec.Meta(ge=0, le=1 << 31)] = 1  # of its slope, hills, channel, shallows and boulders
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)] | None = None  # of its middle; absent: the start
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] | None = None  # of its middle
    tide_m: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.0  # of high water above the mean; it begins at the mean, rising
    tide_s: Annotated[float, msgspec.Meta(ge=60.0, le=1e6)] = 44_712.0  # from high water to high water
    bad_echoes: Fraction = 0.0  # part of the soundings that are of fish or weed above the bottom, or of its second echo

    def __post_init__(self) -> None:
        if (self.latitude_deg is None) is not (self.longitude_deg is None):
            raise ValueError("latitude_deg and longitude_deg go together")


MeetingName = Literal["", "head-on", "give-way", "stand-on", "overtaking", "overtaken", "parallel"]


class VesselTurn(Table, frozen=True):
    """A change of course of another vessel, at `turn_dps`."""

    at_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)]  # after the start of the simulation
    course_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)]


class SimulatedVessel(Table, frozen=True):
    """Another vessel of the simulated world. It starts at latitude and longitude, or so far from where the boat starts."""

    name: Annotated[str, text(r"[ -~]{0,20}", "up to 20 characters")] = ""  # as its AIS tells it
    mmsi: Annotated[int, msgspec.Meta(ge=0, le=999_999_999)] = 0  # 0: 235000000 and its number in the list
    transponder: Literal["A", "B", "none"] = "B"  # class of its AIS
    status: Annotated[int, msgspec.Meta(ge=0, le=15)] = 0  # navigational status of ITU-R M.1371; class A alone tells it
    type: Annotated[int, msgspec.Meta(ge=0, le=99)] = 0  # of ship, of ITU-R M.1371: 30 fishing, 36 sailing, 70 cargo
    length_m: Annotated[float, msgspec.Meta(gt=0.0, le=500.0)] = 12.0  # from bow to stern
    beam_m: Annotated[float, msgspec.Meta(gt=0.0, le=100.0)] = 4.0  # its greatest breadth
    antenna_m: Annotated[float, msgspec.Meta(ge=-250.0, le=250.0)] = 0.0  # of its AIS, ahead of the middle
    north_m: Annotated[float, msgspec.Meta(ge=-100_000.0, le=100_000.0)] = 0.0  # from where the boat starts
    east_m: Annotated[float, msgspec.Meta(ge=-100_000.0, le=100_000.0)] = 0.0  # from there, too
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)] | None = None  # with longitude_deg: where it starts instead
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] | None = None  # with latitude_deg
    course_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)] = 0.0  # over ground
    speed_mps: Annotated[float, msgspec.Meta(ge=0.0, le=50.0)] = 0.0  # over ground
    turns: Annotated[tuple[VesselTurn, ...], msgspec.Meta(max_length=100)] = ()  # changes of course
    turn_dps: Annotated[float, msgspec.Meta(gt=0.0, le=90.0)] = 1.0  # degrees a second
    silent_from_s: Annotated[float, msgspec.Meta(ge=0.0)] | None = None  # its AIS says nothing from here ...
    silent_to_s: Annotated[float, msgspec.Meta(ge=0.0)] | None = None  # ... to here, or to the end
    lost: Fraction = 0.0  # part of its reports that nobody hears
    noise_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 5.0  # standard deviation of its position, which wanders
    follows_m: Annotated[float, msgspec.Meta(ge=0.0, le=20_000.0)] | None = None  # always so far from the boat: a forged one
    follows_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)] = 0.0  # from there in this direction, by north
    sides_s: Annotated[float, msgspec.Meta(ge=0.0, le=86_400.0)] = 0.0  # it changes to the boat's other side so often; 0: never
    chases: bool = False  # it steers for the boat, as fast as it turns
    meets_s: Annotated[float, msgspec.Meta(ge=0.0)] | None = None  # when it is nearest if nobody does anything; for `manner`
    meeting: MeetingName = ""  # what meeting it is for the boat, by rules 13 to 15; for `manner`, and for who judges the run

    def __post_init__(self) -> None:
        if (self.latitude_deg is None) is not (self.longitude_deg is None):
            raise ValueError("latitude_deg and longitude_deg go together")


Vessels = Annotated[tuple[SimulatedVessel, ...], msgspec.Meta(max_length=300)]


class SimulatedTraffic(Table, frozen=True):
    """Other vessels of the simulated world, and how they are heard (docs/encounters.md)."""

    manner: Literal["told", "rules", "late", "turn", "silent", "gap"] = "told"  # of all with `meets_s`; told: as their rows
    heard: Literal["told", "perfect", "A", "B"] = "told"  # told: as their rows; perfect: each second, all, without errors
    lost: Fraction = 0.0  # part of all reports that nobody hears, if it is more than a row says
    vessel: Vessels = ()  # each a table of its own, below


class SimulatedThing(Table, frozen=True):
    """What stands in the simulated water, or a swimmer. Nobody sees it but a look-out."""

    kind: Literal["thing", "person"] = "thing"  # person: a swimmer
    north_m: Annotated[float, msgspec.Meta(ge=-100_000.0, le=100_000.0)] = 0.0  # from where the boat starts
    east_m: Annotated[float, msgspec.Meta(ge=-100_000.0, le=100_000.0)] = 0.0  # from there, too
    radius_m: Annotated[float, msgspec.Meta(ge=0.05, le=50.0)] = 0.5  # all of it is in this circle, and fills it
    course_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)] = 0.0  # where it drifts or swims
    speed_mps: Annotated[float, msgspec.Meta(ge=0.0, le=5.0)] = 0.0  # how fast
    follows_m: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] | None = None  # always so far from the boat: a forged one
    follows_deg: Annotated[float, msgspec.Meta(ge=-360.0, le=360.0)] = 0.0  # from there in this direction, by north


class SimulatedLookout(Table, frozen=True):
    """A sensor that looks round four times a second, played in the name of the payload program that would read it; or a radar
    that speaks for itself. A figure that it does not name is that of its kind."""

    payload: Name | None = None  # the program, of this look-out alone, with the right "obstacles"
    port: Name | None = None  # instead: of [nmea0183.ports], where a radar of kind radar tells its targets by TTM and TLL
    kind: Literal["lidar", "radar", "camera"] = "lidar"  # how far, how exactly, and all round or ahead
    reach_m: Annotated[float, msgspec.Meta(gt=0.0, le=10_000.0)] | None = None  # how far it sees
    missed: Fraction | None = None  # part of the looks at a thing in which it does not see it
    ghosts: Annotated[float, msgspec.Meta(ge=0.0, le=20.0)] | None = None  # things a second that are not there


class SimulatedThings(Table, frozen=True):
    """What stands in the simulated water, and who looks out for it (docs/traffic.md)."""

    world: Literal["", "field", "moorings", "bathers", "entrance", "pocket", "harbour"] = ""  # more to the north, by the seed
    thing: Annotated[tuple[SimulatedThing, ...], msgspec.Meta(max_length=200)] = ()  # each a table of its own, below
    lookout: Annotated[tuple[SimulatedLookout, ...], msgspec.Meta(max_length=8)] = ()  # the same


class SimulatedHull(Table, frozen=True):
    """The hull that is simulated, where it was measured. Without it, it is that of DelfimX in the size of this boat
    (docs/simulator.md)."""

    mass_kg: Annotated[float, msgspec.Meta(ge=0.0, le=1e6)] = 0.0  # ahead, with the water's; 0: nothing here counts
    mass_aside_kg: Annotated[float, msgspec.Meta(ge=0.0, le=1e7)] = 0.0  # sideways, with the water's
    mass_turning_kg: Annotated[float, msgspec.Meta(ge=0.0, le=1e7)] = 0.0  # of leeway in a turn, that pushes ahead
    inertia_kgm2: Annotated[float, msgspec.Meta(ge=0.0, le=1e9)] = 0.0  # of a turn, with the water's
    surge_n_per_mps: Coefficient = 0.0  # drag ahead, with the speed ...
    surge_n_per_mps2: Coefficient = 0.0  # ... and its square
    sway_n_per_mps: Coefficient = 0.0  # drag sideways, with the speed ...
    sway_n_per_mps2: Coefficient = 0.0  # ... its square ...
    sway_ahead_n_per_mps2: Coefficient = 0.0  # ... and its product with the way ahead
    sway_yaw_n_per_radps: Coefficient = 0.0  # force to port of a turn to starboard
    yaw_nm_per_radps: Coefficient = 0.0  # moment against a turn, with its rate ...
    yaw_nm_per_radps2: Coefficient = 0.0  # ... its square ...
    yaw_ahead_nm_s_per_m: Coefficient = 0.0  # ... and its product with the way ahead
    munk_nm_per_mps2: Coefficient = 0.0  # moment of the way ahead and leeway
    thrust_loss_s_per_m: Annotated[float, msgspec.Meta(ge=0.0, le=1.0)] = 0.0  # part of full thrust lost for each m/s of way

    def __post_init__(self) -> None:
        if self.mass_kg and not (self.mass_aside_kg and self.inertia_kgm2):
            raise ValueError("mass_kg, mass_aside_kg and inertia_kgm2 go together")


class Simulation(Table, frozen=True):
    """Settings for simulation alone: `delfim sim`, `delfim nodes`."""

    faults: bool = False  # `delfim fault` may break the boat's own log and links; true in `delfim sim`, never at sea
    interface: Interface = "canloop:can0"  # the bus of a simulated boat
    httpd: Endpoint = "127.0.0.1:8080"  # where its page is
    ftpd: Endpoint = "127.0.0.1:2121"  # where its files are
    sshd: Endpoint = "127.0.0.1:2222"  # where its shell is
    latitude_deg: Annotated[float, msgspec.Meta(ge=-89.0, le=89.0)] = 38.6907  # where it starts
    longitude_deg: Annotated[float, msgspec.Meta(ge=-180.0, le=180.0)] = -9.2153  # where it starts
    heading_deg: Annotated[float, msgspec.Meta(ge=0.0, le=360.0)] = 0.0  # how it lies at start
    mission: str = ""  # played by `delfim sim`, beside the vehicle's file; empty: with --console the boat lies in idle
    noise: bool = True  # false: the sensors measure exactly, whatever the next three say
    position_noise_m: Annotated[float, msgspec.Meta(ge=0.0, le=100.0)] = 0.3  # standard deviation of the position
    heading_noise_deg: Annotated[float, msgspec.Meta(ge=0.0, le=90.0)] = 0.5  # standard deviation of the heading
    speed_noise_mps: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.03  # standard deviation of the speed
    receiver_hz: InstrumentRate = 5.0  # positions a second of a receiver on NMEA 2000, DroneCAN or NMEA 0183; 0: none
    compass_hz: InstrumentRate = 10.0  # headings a second of a compass there, and rates of turn of a gyro; 0: none
    gyro: bool = True  # there is a gyro, too
    sounder_hz: InstrumentRate = 1.0  # depths a second of an echo sounder on NMEA 0183; 0: none
    wind_hz: InstrumentRate = 1.0  # of a wind vane there; 0: none
    motors: bool = True  # motor controllers answer on buses of DroneCAN and VESC; false: you have your own there
    instruments: Annotated[tuple[InstrumentName, ...], msgspec.Meta(max_length=32)] = ()  # empty: all on the first port
    external: Annotated[str, text(rf"([^ :]+:{PORT})?", "ADDRESS:PORT, or empty")] = ""  # of a model in another program
    sea: Sea = Sea()
    sea_bed: SimulatedBed = SimulatedBed()
    hull: SimulatedHull = SimulatedHull()
    traffic: SimulatedTraffic = SimulatedTraffic()
    things: SimulatedThings = SimulatedThings()
