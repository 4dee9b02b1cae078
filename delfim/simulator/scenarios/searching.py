"""Runs that search: each seed aims at a pair of `delfim.simulator.scenarios.pairs`, and draws what may bring about both at
once.

The aim is the seed's place in the list of the possible pairs, so that a run is repeated by its seed alone. All else is drawn:
the parts of the boat, what its failsafe does, and some faults and orders beside those that are aimed at.
"""

from functools import partial
from operator import itemgetter
from random import Random
from typing import Any, Final

import msgspec

from delfim import config
from delfim.base.modes import Mode
from delfim.base.parts import OWN_NODES
from delfim.simulator.faults import OF_AIS, OF_COMPASS, OF_PULSES, OF_THRUSTERS, VALUES
from delfim.simulator.handset import HandsetAt
from delfim.simulator.nodes import nodes_of
from delfim.simulator.scenarios.chased import CHASED, FORGED, chased, forged
from delfim.simulator.scenarios.ordering import DrawnOperator, Words
from delfim.simulator.scenarios.pairs import PAIRS, kind_of
from delfim.simulator.scenarios.random_faults import MIXABLE, MIXED, mixed, place_of
from delfim.simulator.scenarios.scenario import FaultAt, Scenario, ScenarioGuest, laid_over
from delfim.simulator.tables import Simulation

SEARCHING: Final = "searching"


SWIFT: Final[Words] = {  # troubles that need not last as long as at sea
    "console_silent": {"after_s": 1.5},
    "manual_silent": {"after_s": 1.4},
    "guest_silent": {"after_s": 1.0},
    "battery_low": {"after_s": 1.0},
    "battery_critical": {"after_s": 1.0},
    "energy": {"after_s": 1.0},
    "fence_left": {"after_s": 0.5},
    "thruster": {"after_s": 3.0},  # a motor that is stopped coasts for two seconds
    "gnss_poor": {"after_s": 1.0},
    "shallow": {"after_s": 0.5},
    "stuck": {"after_s": 1.5},
    "capsized": {"after_s": 0.5},
    "beyond": {"after_s": 0.5},
    "ais_silent": {"after_s": 2.0},
    "log": {"after_s": 1.0},
    "navigation_frozen": {"after_s": 1.0},
    "clear_s": 1.0,
}
ON_A_BUS: Final[Words] = {"navigation": {"sources": ["nmea2000"], "rate_hz": 10.0, "estimator": True}}
PLAINLY: Final[Words] = {"navigation": {"sources": ["nmea2000"]}}  # without an estimator a lost heading is lost at once
ON_A_LINE: Final[Words] = {
    "navigation": {"sources": ["nmea0183"], "stale_s": 1.5},
    "nmea0183": {"ports": {"gnss": {"device": "/dev/gnss", "baud": 115200}}},
    "failsafe": {"gnss_poor": {"corrections_s": 5.0, "accuracy_m": 5.0}},
}
HANDSET: Final[Words] = {"device": "/dev/receiver", "kill": {"channel": 6}}
NODES: Final = ("propeller_starboard", "batteries_starboard", "gps")  # some that a boat with a motor by pulses has, too


AT_S: Final = 4.0  # the boat is ready
CAPACITY_WH: Final = 20_000.0  # about that of the simulated batteries
EASY: Final = ("log", "gnss_poor", "battery_low", "sensor_bad", "sensor_bad", "handset_silent")  # come when they are asked for
WITHOUT_TABLE: Final = ("control", "kill", "restarted")  # what the boat does for them is not a matter of its file
OF_DEPTH: Final[Words] = {"shallow": {"min_depth_m": 1.0}, "beyond": {"below": {"depth_m": 1.0}}}
BROKEN: Final = {"console_silent": "console_lost", "guest_silent": "guest_lost", "outlet": "outlet_silent", "stuck": "weeds"}
OF_VESSELS: Final = ("traffic", "traffic_close", "traffic_unclear", "ais_silent")
HARMLESS: Final = (  # orders after which the boat goes on as before
    *("take", "set", "rally", "speed", "leg", "arm", "goto refused", "mode refused", "mission refused", "upload refused"),
    *("play refused", "leg refused", "fence refused", "set refused", "actuate refused"),
)
AT_REST: Final = ("actuate", "reset", "arm refused", "pause refused")  # orders to a boat in idle
UNFIT: Final = ("heading refused", "course refused", "manual refused", "play refused", "mode refused", "arm refused")
AIMS: Final = tuple(Random("aims").sample(PAIRS, len(PAIRS)))  # so that any stretch of seeds tries something of all


def searching(seed: int, vehicle: config.Vehicle) -> Scenario:
    """Draw the run of a seed."""
    return _Aimed(Random(f"searching {seed}"), vehicle, AIMS[seed % len(AIMS)]).scenario(seed)


class _Aimed:
    """A run that is being drawn."""

    def __init__(self, random: Random, vehicle: config.Vehicle, aim: tuple[str, str]) -> None:
        self.random, self.vehicle, self.aim = random, vehicle, aim
        self.place, self.thrusters = partial(place_of, vehicle.of(Simulation)), [row.name for row in vehicle.thrusters]
        self.operator = DrawnOperator(random, self.place, self.thrusters[0])
        # Its parts may be others then.
        self.has_nodes = vehicle.navigation.sources == (OWN_NODES,) and not vehicle.driven("nodes", False)
        self.at_s, self.tree = random.uniform(8.0, 13.0), dict[str, Any]()
        self.end_s = self.at_s + random.uniform(10.0, 24.0)
        self.orders, self.faults, self.vessels = list[Words](), list[FaultAt](), list[Words]()
        self.handset: tuple[HandsetAt, ...] = ()
        self.is_led = self.is_carried = self.is_plain = False  # by a guest computer; by the current; without an estimator
        named = {kind: [each.partition(" ")[2] for each in aim if kind_of(each) == kind] for kind in map(kind_of, aim)}
        self.modes, self.troubles = named.get("mode", []), named.get("trouble", [])
        self.action, self.order = (named.get(kind, [""])[0] for kind in ("action", "order"))
        self.silences = {"manual_silent", "guest_silent", "console_silent", "restarted"} & {*self.troubles}
        # An order to a boat in idle, in the very cycle in which its failsafe stops it, or finds that it cannot hold.
        self.rests = self.order in AT_REST and bool(self.troubles or self.action in ("hold", "back", "home", "unstick"))
        self.lies = bool({"navigation_frozen", "navigation_jumping", "navigation_twice"} & {*self.troubles})
        brief = {"control", "navigation_silent"} & {*self.troubles}
        self.in_a_moment = self.rests or self.action == "home" or bool(brief)  # both meet in a cycle or two alone

    def scenario(self, seed: int) -> Scenario:
        self._parts()
        self._sea()
        self._aim()
        self._sail()
        if self.order:
            self._ask()
        self._chance()
        orders = sorted((each for each in self.orders if each["at_s"] < self.end_s), key=itemgetter("at_s"))
        return Scenario(
            version=1,
            name=f"searching for {self.aim[0]} with {self.aim[1]}, seed {seed}",
            seconds=self.end_s,
            vehicle=self.tree,
            guest=ScenarioGuest(heading_deg=self.random.uniform(0.0, 360.0), speed_mps=1.0) if self.is_led else None,
            command=tuple(orders),
            fault=tuple(self.faults if self.has_nodes else self._breakable()),
            vessel=tuple(self.vessels),
            handset=self.handset,
            patient=False,
        )

    def _breakable(self) -> list[FaultAt]:
        """The faults that this boat can have: what it lacks does not break."""
        settings = config.read(laid_over(msgspec.to_builtins(self.vehicle), self.tree), "the scenario")
        nodes = nodes_of(settings, 0)
        lacks = {*(() if nodes.compasses else OF_COMPASS), *(() if nodes.shipping else OF_AIS)}
        lacks |= {*(() if settings.driven("outlet") else OF_PULSES)}
        places = {"", *self.thrusters, *nodes.sensors, *(["compass"] if nodes.compasses else [])}
        return [each for each in self.faults if each.kind not in lacks and each.where in places]

    def _lay(self, tree: Words) -> None:
        self.tree = laid_over(self.tree, tree)

    def _does(self, trouble: str, action: str) -> None:
        """Set the action of a trouble in the boat's file, for all modes."""
        modes = {mode.name.lower(): "same" for mode in Mode if mode is not Mode.IDLE}
        self._lay({"failsafe": {trouble: {**modes, "action": action}}})

    def _break(self, kind: str, at_s: float, where: str = "", value: float | None = None, for_s: float | None = None) -> None:
        self.faults.append(FaultAt(at_s=at_s, kind=kind, where=where, value=value, for_s=for_s))

    def _blink(self, kind: str, at_s: float, for_s: float, every_s: float, where: str = "") -> None:
        """Break something again and again: what happens in the one cycle in which a trouble begins gets as many chances."""
        while at_s < self.end_s:
            self._break(kind, at_s, where, None, for_s)
            at_s += every_s

    def _parts(self) -> None:
        """Draw other sensors and motors than the boat's file has, as far as those leave what is aimed at."""
        random, others = self.random, "navigation_twice" not in self.troubles and self.has_nodes
        self.is_plain = others and (
            ("control" in self.troubles and self.order != "heading") or (self.rests and bool(self.action))
        )
        on_a_line = others and not self.is_plain and random.random() < 0.2
        if self.is_plain:
            self._lay(PLAINLY)
        elif others and "control" in self.troubles:  # of an estimate the velocity is lost first
            self._lay(ON_A_BUS)
        elif others and random.random() < 0.3:
            self._lay(ON_A_LINE if on_a_line else ON_A_BUS)
        if self.has_nodes and ("outlet" in self.troubles or random.random() < 0.1):
            kept, *rows = map(msgspec.to_builtins, self.vehicle.thrusters)  # one stays on the bus
            self._lay({"thrusters": [kept, *(row | {"driver": "pwm"} for row in rows)]})
        self._lay({"log": {"required": random.random() < 0.2}, "failsafe": SWIFT})
        self._lay({"failsafe": {"pause_s": 0.0 if self.action == "home" else random.choice((0.0, 5.0)), "back_m": 10.0}})
        after = (
            ("idle",)
            if self.rests or self.action == "disconnect"
            else ("hold",)
            if self.order == "continue"
            else ("hold", "resume", "resume", "home")
        )
        self._lay({"failsafe": {"restarted": {"action": random.choice(after)}}})

    def _sea(self) -> None:
        random, wide_m = self.random, 65.0
        is_near = bool({"fence", "fence_left"} & {*self.troubles})
        self.is_carried = "fence_left" in self.troubles or (is_near and random.random() < 0.5)
        sea = {
            "current_mps": random.uniform(1.8, 2.4) if self.is_carried else random.uniform(0.0, 0.4),
            "current_to_deg": random.uniform(0.0, 360.0),
            "wind_mps": random.uniform(0.0, 6.0),
            "wind_from_deg": random.uniform(0.0, 360.0),
        }
        self._lay({"simulation": {"sea": sea, "heading_deg": random.uniform(0.0, 360.0)}})
        if self.is_carried:  # out of its fence, which nobody blames on a boat with a broken motor
            self.at_s, self.end_s = self.at_s + 6.0, self.end_s + 8.0
            self._does("thruster", "warn")
            self._break("thruster_dead", AT_S + 1.0, self.thrusters[-1])
            if self.modes != ["hold"]:
                self._does("fence", "warn")
        if is_near:
            area = {"centre": [self.place(0.0, random.uniform(-4.0, 4.0))], "radius_m": random.uniform(21.0, 26.0)}
            self._lay({"fence": {"keep_in": [area]}})
        elif random.random() < 0.3:
            corners = [self.place(n * wide_m, e * wide_m) for n, e in ((1, -1), (1, 1), (-1, 1), (-1, -1))]
            rock = {"centre": [self.place(45.0, 0.0)], "radius_m": 10.0}
            self._lay({"fence": {"keep_in": [{"polygon": corners}], "keep_out": [rock]}})

    def _aim(self) -> None:
        """Set the troubles, and the boat's actions: as its file says, those aimed at, or none, so that the troubles last."""
        random, carriers = self.random, [each for each in self.troubles if each not in WITHOUT_TABLE]
        if self.action == "disconnect":
            self._lay({"failsafe": {"thruster": {"after_s": 1.5}}})
            self._break("thruster_stuck", self.at_s, self.thrusters[0])
            self.orders += [{"at_s": self.at_s + random.uniform(0.5, 4.0), "command": "stop"}]
        elif self.action:
            easy = ("sensor_bad",) if self.action == "home" else EASY
            carrier = random.choice(carriers if carriers and random.random() < 0.5 else easy)
            if carrier not in carriers:
                self._bring(carrier, self.at_s + random.uniform(-1.0, 4.0))
            if carrier not in ("fence", "navigation_silent") or self.action != "warn":
                self._does(carrier, self.action)
            carriers = [each for each in carriers if each != carrier]
        for each in () if self.modes else carriers:
            if self.rests and not self.action:
                self._does(each, "stop")
            elif each not in ("fence", "navigation_silent") and (each in self.silences or random.random() < 0.75):
                self._does(each, "warn")
        for each in self.troubles:
            self._bring(each, self.at_s + random.uniform(0.0, 4.0))
        if self.is_plain and "control" not in self.troubles:  # by hand it needs no heading, to hold it does
            self._break("navigation_silent", AT_S, "compass")

    def _bring(self, trouble: str, at_s: float) -> None:
        """Bring about a trouble near this time."""
        random, often = self.random, self.random.random() < 0.6 or self.action == "home"
        match trouble:
            case "control" if self.is_plain:
                self._blink("navigation_silent", at_s, 2.0, 4.0, "compass")
            case "control":
                self._does("navigation_silent", "warn")
                self._blink("navigation_silent", at_s, 1.15, 3.0)
            case "navigation_jumping":
                self._blink("navigation_jumping", at_s, 3.0, 6.0)
            case "navigation_silent" if (often or self.order) and not (self.rests or self.modes or self.lies):
                self._does("navigation_silent", "warn")  # so briefly that nobody sails blind
                self._blink("navigation_silent", at_s, 1.15, 3.0)
            case "navigation_silent":
                self._blink("navigation_silent", at_s, 4.0, 7.0)
            case "navigation_frozen":
                self._blink(random.choice(("navigation_frozen", "navigation_repeating")), at_s, 4.0 if often else 2.0, 6.0)
            case "navigation_twice":
                self._blink("navigation_forged", at_s, 2.0, 12.0)
            case "sensor_bad" if often:
                self._blink("sensor_bad", at_s, 2.0, 4.5, random.choice(NODES))
            case "sensor_bad":
                self._break(random.choice(("sensor_bad", "sensor_silent")), at_s, random.choice(NODES))
            case "battery_low" | "battery_critical":
                charge = random.uniform(0.15, 0.24) if trouble == "battery_low" else random.uniform(0.06, 0.09)
                if trouble == "battery_critical" and "sensor_bad" not in self.troubles:
                    self._does("sensor_bad", "warn")  # or the voltage, which is low then, stops the boat before the charge does
                self._break("battery_sag", at_s, self.thrusters[0], charge)
            case "energy":
                self._lay({"energy": {"capacity_wh": CAPACITY_WH, "reserve": 0.9}})  # what a low battery would not tell
                self._break("battery_sag", at_s, self.thrusters[0], random.uniform(0.5, 0.85))
            case "thruster":
                kind = random.choice(("thruster_dead", "thruster_stuck", "thruster_reversed"))
                self._break(kind, at_s, self.thrusters[0])
            case "gnss_poor":
                kinds = ("gnss_poor", "accuracy_poor", "corrections_lost") if "nmea0183" in self.tree else ("gnss_poor",)
                self._break(random.choice(kinds), at_s)
            case "log":
                self._break(random.choice(("disk_full", "disk_full", "disk_slow")), at_s)
            case "shallow" | "beyond":
                self._hears()
                self._lay({"failsafe": {trouble: OF_DEPTH[trouble]}})
                self._break("shallow", at_s)
            case "capsized":
                self._blink("capsized", at_s, 3.0, 6.0)
            case _ if trouble in OF_VESSELS:
                self._meets(trouble, at_s)
            case "restarted":
                self._blink("restarted", at_s, 1.0, 7.0)
            case "handset_silent":
                self._by_hand(HandsetAt(at_s=at_s, radio=False))
            case "kill" if self.order == "clear refused" or random.random() < 0.3:
                self._by_hand(HandsetAt(at_s=at_s, kill=True), HandsetAt(at_s=at_s + random.uniform(1.0, 9.0)))
            case "kill":
                self.orders += [{"at_s": at_s, "command": "kill"}]
            case _ if trouble in BROKEN:
                self._break(BROKEN[trouble], at_s)

    def _hears(self) -> None:
        self._lay({"sensors": {"names": [*dict.fromkeys((*self.vehicle.sensors.names, "nmea2000"))]}})

    def _by_hand(self, *rows: HandsetAt) -> None:
        """Draw the actions of somebody with a hand-set."""
        self._lay({"handset": HANDSET})
        self.handset = tuple(sorted((*(self.handset or (HandsetAt(at_s=0.0),)), *rows), key=lambda row: row.at_s))

    def _meets(self, trouble: str, at_s: float) -> None:
        """Place other vessels."""
        random = self.random
        self._hears()
        self.end_s += 15.0
        self._lay({"simulation": {"traffic": {"heard": "perfect"}}})
        row: Words = {"transponder": "A", "length_m": random.choice((12.0, 60.0)), "beam_m": 5.0}
        if trouble == "traffic_unclear":
            row |= {"speed_mps": 12.0, "course_deg": 180.0, "north_m": 900.0, "east_m": 300.0}
            self._break("ais_wrong", at_s - 5.0, "", 200.0)
        elif trouble == "ais_silent":
            row |= {"north_m": 2000.0}
            self._break("ais_silent", at_s)
        elif random.random() < 0.5:
            row |= {"chases": True, "turn_dps": 10.0, "speed_mps": 4.0, "north_m": 60.0, "east_m": random.uniform(-60.0, 60.0)}
        else:
            row |= {"follows_m": random.uniform(5.0, 60.0), "follows_deg": random.uniform(0.0, 360.0)}
            row |= {"speed_mps": 2.0, "course_deg": (row["follows_deg"] + 180.0) % 360.0}
        self.vessels.append(row)

    def _sail(self) -> None:
        """Enter the mode that is aimed at, again whenever the boat may have left it."""
        random, at_s = self.random, AT_S
        steady = self.in_a_moment or "navigation_frozen" in self.troubles
        some = (
            ("course",)
            if "control" in self.troubles and not self.is_plain
            else ("heading", "course")
            if steady
            else ("heading", "course", "hold", "play", "goto", "manual")
        )
        self.mode = (self.modes or [random.choice(some if self.order != "unload refused" else ("play", "path"))])[0]
        if "manual_silent" in self.troubles or (self.is_plain and "control" not in self.troubles):
            self.mode = "manual"
        elif "guest_silent" in self.troubles:
            self.mode = "grex"
        self.is_led = self.mode == "grex" or random.random() < 0.2
        self.orders.append({"at_s": 1.0, **self.operator.word("mission")})
        if self.mode in ("home", "hold", "idle"):
            self.orders.append({"at_s": at_s, **self.operator.word("heading"), "speed_mps": 2.0})
            self._lay({"control": {"home": {"speed_mps": 0.4}}})
            at_s += 4.0
        every_s = random.choice((1.2, 3.0, 6.0))
        if self.silences:
            every_s = 4.0
        elif self.mode == "manual":
            every_s = 0.9
        is_left = self.action == "disconnect" or (self.silences and not (self.rests and "manual_silent" in self.silences))
        until_s = self.at_s if is_left else self.end_s
        while at_s < until_s:
            self.orders.append({"at_s": at_s, **self._enters()})
            at_s += every_s

    def _enters(self) -> Words:
        """Enter a mode: by hand without thrust where silence is aimed at, or where the failsafe took the thrust away."""
        is_still = self.mode == "manual" and (self.silences or self.in_a_moment) and "navigation_frozen" not in self.troubles
        return {"command": "mode", "mode": "manual"} if is_still else self.operator.enters(self.mode)

    def _ask(self) -> None:
        """Give the order that is aimed at as a stream, so that a moment of one cycle is not missed."""
        random, order = self.random, self.operator.word(self.order)
        if self.order == "mode" and (self.in_a_moment or "kill" in self.troubles or self.action == "disconnect"):
            order = {"command": "mode", "mode": "idle"}  # the others are refused then
        words, every_s = [order], random.choice((0.2, 0.2, 0.4, 1.0, 2.5))
        if self.order in UNFIT and random.random() < 0.8:
            self._unfit(self.order.partition(" ")[0])
        if "restarted" in self.troubles:  # any order ends that trouble: this one is the first
            for at_s in [each.at_s for each in self.faults if each.kind == "restarted"]:
                back_s = at_s + random.uniform(2.5, 4.0)
                self.orders += [{"at_s": back_s, **order}, {"at_s": back_s + 2.0, **self.operator.enters(self.mode)}]
            return
        if "console_silent" in self.troubles:
            words, every_s = [self._enters(), order], random.uniform(1.5, 1.8) if self.rests else 2.0
        elif "manual_silent" in self.troubles and not self.rests:
            words, every_s = [self._enters(), order], 2.5
        elif self.in_a_moment:
            before = [] if self.order in AT_REST else self.operator.before(self.order)
            is_steady = self.order == "arm refused" or (self.rests and not self.action and "control" not in self.troubles)
            if self.order == "kill":
                before = [self.operator.word("clear"), self._enters()]
            elif self.order == "manual":  # who pushes on after the boat was stopped is refused
                before = 6 * [self._enters()]
            words, every_s = [*(before or ([] if is_steady else [self._enters()])), order], 0.2
        elif self.silences:
            every_s = random.choice((0.2, 1.0))
        elif random.random() < 0.8 and (before := self.operator.before(self.order)):
            words = [*before, order]
        elif random.random() < 0.7:
            words = [self._enters(), order]
        if self.order == "reset refused" and not self.modes and random.random() < 0.6:  # in idle by a bus that is off alone
            words, every_s = [order, {"command": "stop"}], 1.0
            self._blink("bus_off", self.at_s, 3.0, 6.0)
        if self.order == "actuate":  # who holds on while he is refused is refused again
            every_s = max(every_s, 1.0)
        at_s = self.at_s + random.uniform(*((-1.0, 1.0) if self.in_a_moment else (-1.0, 7.0)))
        if "guest_silent" in self.silences and not self.rests:
            at_s = self.at_s + random.uniform(4.0, 7.0)
        if self.is_carried and self.rests:  # it is out of its fence once, and soon
            at_s = AT_S + 2.0
        for i in range(int((20.0 if self.in_a_moment else random.uniform(6.0, 15.0)) / every_s) + 1):
            self.orders.append({"at_s": at_s + i * every_s, **words[i % len(words)]})

    def _unfit(self, asked: str) -> None:
        """Make navigation so poor that the boat refuses this mode, but would not stop in another one."""
        mode = {"arm": "manual", "mode": "hold"}.get(asked, asked)
        self._does("gnss_poor", "warn")
        self._lay({"failsafe": {"gnss_poor": {mode: "hold", **({} if "gnss_poor" in self.troubles else {"after_s": 30.0})}}})
        self._break("gnss_poor", self.at_s - 1.0)

    def _chance(self) -> None:
        """Draw faults and orders at random, beside those aimed at; each run has some kinds of them alone."""
        random = self.random
        is_brief = {"navigation_silent", "control"} & {*self.troubles}
        but = ("sensor_", *OF_THRUSTERS, *(("frames_", "bus_", "navigation_") if is_brief else ()))
        kinds = random.sample([kind for kind in MIXABLE if not kind.startswith(but)], 3)
        for _ in range(random.choice((0, 0, 0, 1, 2))):
            kind = random.choice(kinds)
            value = VALUES[kind][0] * random.uniform(0.5, 1.5) if kind in VALUES else None
            self._break(kind, random.uniform(8.0, self.end_s), "", value, random.uniform(0.5, 10.0))
        for _ in range(0 if self.silences else 8):
            self.orders.append({"at_s": random.uniform(self.at_s, self.end_s), **self.operator.word(random.choice(HARMLESS))})
        if random.random() < 0.3:
            word = self.operator.word(random.choice(("stop", "goto", "pause", "set", "take", "arm", "unload", "mission")))
            self.orders.append({"at_s": random.uniform(8.0, self.end_s), **word})


DRAWN: Final = {
    MIXED: mixed,
    CHASED: chased,
    FORGED: forged,
    SEARCHING: searching,
}  # what a seed draws, by the name of the scenario
