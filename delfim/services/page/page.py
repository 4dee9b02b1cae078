"""The page: each section is a function from the data to HTML. The server sends a section again when its HTML has changed.

All text from outside is escaped here. The most important news stands first, in words.
"""

from collections.abc import Callable, Iterable, Sequence
from datetime import UTC, datetime
from html import escape
from typing import Any, Final, NamedTuple

from delfim import config
from delfim.services.page import figures
from delfim.services.page.api import Network, Report
from delfim.services.page.wording import (
    as_told,
    gauges,
    knots,
    last_words,
    number,
    of_node,
    of_thruster,
    rate,
    size,
    span,
    tile,
    worded,
)
from delfim.vehicle.navigation import gnss
from delfim.vehicle.report import BoatReport, Service, VesselSeen

HURT: Final = ("stop", "disconnect")  # actions of the failsafe that end the sailing
OWN_WILL: Final = ("operator", "started", "")  # reasons to lie idle that need no attention
GONE: Final = "the vehicle does not answer"
VESSELS_MAX: Final = 12  # rows: they take 60 µs to write
SEES: Final = "Sees only who transmits."


class PageView(NamedTuple):
    """The data of all sections."""

    report: Report
    settings: config.Vehicle
    way: Sequence[tuple[float, float]] = ()  # latitude, longitude in degrees, oldest first


class Section(NamedTuple):
    id: str
    title: str
    render: Callable[[PageView], str]
    every_s: float  # figures and tables of the computer need not run with every second
    column: int  # on a wide screen; on a phone they stand below each other


def head(view: PageView) -> str:
    """The mode in letters that are read at arm's length in the sun, and why."""
    vehicle, reason = view.report.vehicle, view.report.reason
    name = escape(vehicle.boat if vehicle else view.settings.boat.name)
    if vehicle is None:
        return f'<div class="band bad"><p>{name}</p><h1>No answer</h1><p class="why">{escape(reason or GONE)}</p></div>'
    why = vehicle.reason if vehicle.reason != "operator" else "as the operator asked"
    if vehicle.mode == "play":
        why = f"{vehicle.mission or 'mission'}, leg {vehicle.reference.leg + 1} of {vehicle.legs}: {why}"
    mode = f"payload {vehicle.helmsman}: {vehicle.mode}" if vehicle.helmsman else vehicle.mode
    return (
        f'<div class="band {mood(vehicle)}"><p>{name}</p><h1>{escape(mode[:1].upper() + mode[1:])}</h1>'
        f'<p class="why">{escape(why)}{f" ({escape(vehicle.operator)} commands)" if vehicle.operator else ""}</p></div>'
    )


def mood(vehicle: BoatReport) -> str:
    """The colour of the band: how the boat fares, in a word."""
    if any(notice.action in HURT for notice in vehicle.notices):
        return "bad"
    if vehicle.mode == "idle":
        return "calm" if vehicle.reason in OWN_WILL else "warn"
    return "warn" if vehicle.notices else "good"


def warnings(view: PageView) -> str:
    """Everything that needs attention now, worst first."""
    found = list(troubles(view))
    if not found:
        return '<p class="well">Nothing to report.</p>'
    rows = (f'<li class="{kind}"><b>{escape(name)}</b> {escape(text)}</li>' for kind, name, text in found)
    return f'<ul class="lines">{"".join(rows)}</ul>'


def troubles(view: PageView) -> Iterable[tuple[str, str, str]]:
    """(kind, name, words) of each."""
    report = view.report
    vehicle = report.vehicle
    if vehicle is None:
        yield "bad", "vehicle", report.reason or GONE
    else:
        for notice in vehicle.notices:
            yield "bad" if notice.action in HURT else "warn", notice.name.replace("_", " "), f"{notice.reason}: {notice.action}"
        for name, node in vehicle.sysstat.items():
            if node.status != "good":
                yield "bad", worded(name), f"{node.status} {', '.join(map(worded, node.faults))}"
        if vehicle.log.reason:
            yield "bad", "log", vehicle.log.reason
        if vehicle.deadman:
            yield "bad", "dead-man", str(vehicle.deadman.get("reason", ""))
    computer = report.computer
    for name, service in [*report.services.items(), *(computer.supervisor if computer else {}).items()]:
        if service.state in ("waiting", "failed") or service.reason.startswith("does not answer"):
            yield "bad", name, f"{service.state}: {service.reason}"
        for part, words in service.figures.get("troubles", {}).items():
            yield "bad", f"{name} {part}", str(words)
    if vehicle is not None:
        for name, count in vehicle.counts.items():
            yield "note", worded(name), f"{count} times"
    if computer and computer.disk and computer.disk.free_bytes < 2 * view.settings.log.free_bytes_min:
        yield "warn", "disk", f"{size(computer.disk.free_bytes)} free"


def motion(view: PageView) -> str:
    vehicle = view.report.vehicle
    if vehicle is None:
        return f'<p class="none">{GONE}</p>'
    reference = vehicle.reference
    wanted = f"to {number(reference.heading_deg, '03.0f')}°" if reference.heading_deg is not None else "&nbsp;"
    asked = knots(vehicle.speed_mps) + _asked(reference.speed_mps)
    track = f"{number(reference.cross_track_m, '+.1f')} m off track" if reference.cross_track_m is not None else "&nbsp;"
    rows = "".join(
        f'<div class="side"><b>{worded(name)}</b> {figures.thrust(each.thrust)} <span>{of_thruster(each)}</span></div>'
        for name, each in vehicle.thrusters.items()
    )
    quality = gnss.in_words(vehicle.fix, vehicle.satellites, vehicle.hdop, vehicle.accuracy_m, vehicle.corrections_s)
    position = f"{number(vehicle.latitude_deg, '.6f')}, {number(vehicle.longitude_deg, '.6f')}"
    return (
        f'<div class="tiles"><div class="rose">{figures.compass(vehicle.heading_deg, reference.heading_deg)}</div>'
        f"{tile('Heading', number(vehicle.heading_deg, '03.0f'), '°', wanted)}"
        f"{tile('Speed', number(vehicle.speed_mps, '.2f'), 'm/s', asked)}"
        f"{tile('To go', number(reference.distance_m, '.0f'), 'm', track)}</div>{rows}"
        f'<p class="small">{position} · {quality} · by {escape(vehicle.source or "nobody")}'
        f"{_batteries(vehicle)}</p>"
    )


def _asked(speed_mps: float | None) -> str:
    if speed_mps is None:
        return "&nbsp;"
    return f"asked for {speed_mps:.1f}" if speed_mps > 0 else "asked to lie still"


def where(view: PageView) -> str:
    """The track, the boat, and the point that it steers for."""
    vehicle = view.report.vehicle
    if vehicle is None or vehicle.latitude_deg is None or vehicle.longitude_deg is None:
        return '<p class="none">its position is not known</p>'
    to = vehicle.reference
    there = (to.latitude_deg, to.longitude_deg) if to.latitude_deg is not None and to.longitude_deg is not None else None
    here = vehicle.latitude_deg, vehicle.longitude_deg
    return (
        f"{figures.chart(view.way, here, vehicle.heading_deg, there)}"
        '<p class="small">Its track since this page was first opened. The dashed line leads to the point it steers for.</p>'
    )


def _batteries(vehicle: BoatReport) -> str:
    charged = [(name, node) for name, node in vehicle.sysstat.items() if node.charge is not None]
    return "".join(
        f" · {escape(name.removeprefix('batteries_'))} batteries {number(node.charge, '.0%')} {number(node.voltage_v, '.1f')} V"
        for name, node in charged
    )


def inputs(view: PageView) -> str:
    """The age of every input beside the age at which it counts as silent."""
    vehicle = view.report.vehicle
    if vehicle is None:
        return f'<p class="none">{GONE}</p>'
    rows = []
    for name, age_s in vehicle.age_s.items():
        limit_s = _limit_s(view.settings, name, name in vehicle.measured)
        used = name != "guest" or vehicle.guest_connected
        kind = "" if not used else "bad" if age_s is None or age_s > limit_s else "warn" if age_s > 0.6 * limit_s else "good"
        node = vehicle.sysstat.get(name)
        said = of_node(node) if node else number(vehicle.measured[name], ".2f") if name in vehicle.measured else ""
        told = f'<span class="more">{said}</span>' if said else ""
        text = "never heard" if age_s is None else span(age_s)
        rows.append(
            f'<tr class="{kind}"><th>{worded(name)}{told}</th><td class="gauge">{figures.bar(age_s or 0.0, limit_s, kind)}</td>'
            f'<td class="value">{text}</td></tr>'
        )
    return f'<table class="ages">{"".join(rows)}</table><p class="small">A full bar is the limit of the vehicle’s file.</p>'


def _limit_s(settings: config.Vehicle, name: str, is_measured: bool) -> float:
    named = {"navigation": settings.navigation.stale_s, "console": settings.failsafe.console_silent.after_s}
    named |= dict.fromkeys(("guest", "payload"), settings.failsafe.guest_silent.after_s)  # a payload's name follows
    return named.get(name.partition(" ")[0], settings.sensors.stale_s if is_measured else settings.sysstat.stale_s)


def latency(view: PageView) -> str:
    vehicle = view.report.vehicle
    if vehicle is None or not vehicle.latency.n:
        return '<p class="none">no navigation cycle yet</p>'
    told = vehicle.latency
    marks = (("median", "median", told.p50_us), ("p99", "99 %", told.p99_us), ("worst", "worst", told.worst_us))
    key = "".join(f'<span class="key {name}">{words} <b>{figures.micros(us)}</b></span>' for name, words, us in marks)
    return (
        f'{figures.histogram(told)}<p class="keys">{key}</p>'
        f'<p class="small">{told.n} cycles, {told.within_100_us:.2%} within 100 µs. From the kernel’s receive time '
        "of navigation to the command of the propellers.</p>"
    )


def stages(view: PageView) -> str:
    """Figure 3-11: where the time of a cycle goes, on average."""
    vehicle = view.report.vehicle
    if vehicle is None or not vehicle.latency.n:
        return '<p class="none">no navigation cycle yet</p>'
    means = vehicle.latency.stages_us
    most = max([*means.values(), 1e-9])
    rows = "".join(
        f'<tr><th>{worded(name)}</th><td class="gauge">{figures.bar(mean, most, "after" if name == "log" else "")}</td>'
        f'<td class="value">{figures.micros(mean)}</td></tr>'
        for name, mean in means.items()
    )
    return f'<table>{rows}</table><p class="small">Means. The log comes after the propellers have their command.</p>'


def services(view: PageView) -> str:
    report = view.report
    supervisor = report.computer.supervisor if report.computer else {}
    rows = [_service(view, name, service) for name, service in report.services.items()]
    rows += [_service(view, name, service) for name, service in supervisor.items() if name not in report.services]
    dead = report.computer.deadman if report.computer else ""
    note = f'<p class="small">Dead-man: {escape(dead)}</p>' if dead else ""
    return f'<ul class="services">{"".join(rows)}</ul>{note}'


def _service(view: PageView, name: str, service: Service) -> str:
    kind = {"running": "good", "starting": "warn", "stopped": "calm"}.get(service.state, "bad")
    told = [f"for {span(service.for_s)}", "in the runtime" if service.place == "runtime" else f"process {service.pid or '–'}"]
    if service.longest_callback_s:
        slow = service.longest_callback_s > view.settings.runtime.callback_budget_s
        text = f"longest callback {figures.micros(service.longest_callback_s * 1e6)}"
        told.append(f'<b class="warn">{text}</b>' if slow else text)
    if service.busy_s:
        told.append(f"{100 * service.busy_s / max(service.for_s, 1e-3):.1f} % busy")
    if service.memory_bytes:
        told.append(size(service.memory_bytes))
    if service.restarts:
        told.append(f'<b class="warn">restarted {service.restarts} times</b>')
    if service.reason:
        told.append(f"last event: {escape(service.reason)}")
    return (
        f'<li><b class="name">{escape(name)}</b> <span class="pill {kind}">{escape(service.state)}</span>'
        f'<span class="small">{" · ".join(told)}</span>{_figures(service.figures)}</li>'
    )


def _figures(figures: dict[str, Any]) -> str:
    """A service's own figures: a row each. Figures of several things, such as buses, are a table with a row for each."""
    rows, tables = [], []
    for key, value in figures.items():
        if isinstance(value, dict) and value and all(isinstance(each, dict) for each in value.values()):
            tables.append(_several(worded(key), value))
        else:
            rows.append(f"<tr><th>{worded(key)}</th><td>{as_told(value)}</td></tr>")
    return (f'<table class="figures">{"".join(rows)}</table>' if rows else "") + "".join(tables)


def _several(name: str, things: dict[str, dict[str, Any]]) -> str:
    keys = list(dict.fromkeys(key for thing in things.values() for key in thing))
    head = "".join(f"<th>{worded(key)}</th>" for key in keys)
    rows = "".join(
        f"<tr><th>{escape(each)}</th>{''.join(f'<td>{as_told(thing.get(key))}</td>' for key in keys)}</tr>"
        for each, thing in things.items()
    )
    return f'<table class="several"><thead><tr><th>{name}</th>{head}</tr></thead>{rows}</table>'


def buses(view: PageView) -> str:
    """CAN controllers as the kernel sees them; a bus without hardware has none."""
    computer, vehicle = view.report.computer, view.report.vehicle
    found = computer.buses if computer else {}
    rows = []
    for name, bus in found.items():
        kind = "good" if bus.state in ("error active", "up", "unknown", "") else "bad"
        load = "" if bus.load is None else f'<td class="gauge">{figures.bar(bus.load, 1.0)}</td><td>{bus.load:.0%}</td>'
        counters = "" if bus.transmit_errors is None else f" · error counters {bus.transmit_errors} / {bus.receive_errors}"
        rows.append(
            f'<tr><th>{escape(name)} <span class="pill {kind}">{escape(bus.state or "up")}</span></th>{load}</tr>'
            f'<tr><td colspan="3" class="small">{bus.frames_per_s:.0f} frames/s · {bus.frames} frames · '
            f"{bus.dropped} dropped · {bus.errors} errors · bus off {bus.bus_off} times{counters}</td></tr>"
        )
    if not rows:
        name = escape(view.settings.can.interface)
        rows.append(f'<tr><td class="none">{name} has no controller for which the kernel counts</td></tr>')
    refused = vehicle.counts if vehicle else {}
    counts = "".join(f"<tr><th>{worded(name)}</th><td>{count}</td></tr>" for name, count in refused.items())
    return f"<table>{''.join(rows)}{counts}</table>" + ("" if counts else '<p class="small">The vehicle refused nothing.</p>')


def computer(view: PageView) -> str:
    found = view.report.computer
    if found is None:
        return '<p class="none">no data yet</p>'
    used = found.memory.total_bytes - found.memory.available_bytes
    rows = [(f"CPU {n}", share, 1.0, f"{share:.0%}") for n, share in enumerate(found.cpu)]
    rows.append(("Memory", used, found.memory.total_bytes, f"{size(used)} of {size(found.memory.total_bytes)}"))
    told = [f"up {span(found.uptime_s)}", f"load {' '.join(f'{each:.2f}' for each in found.load)}"]
    if found.temperature_c is not None:
        told.append(f"{found.temperature_c:.0f} °C")
    return f'{gauges(rows)}<p class="small">{" · ".join(told)}</p>'


def disk(view: PageView) -> str:
    found, vehicle = view.report.computer, view.report.vehicle
    if found is None or found.disk is None:
        return '<p class="none">no data yet, or no such disk</p>'
    space = found.disk
    used = space.total_bytes - space.free_bytes
    full = "not filling" if space.full_in_s is None else f"full in {span(space.full_in_s)} at this rate"
    keep = view.settings.log.free_bytes_min
    then = "then the oldest days are deleted" if view.settings.log.when_full == "delete-oldest" else "then logging stops"
    log = ""
    if vehicle is not None:
        status = vehicle.log
        state = "being written" if status.writable else f"not written: {status.reason}"
        log = f'<p class="small">State log {escape(state)}: {status.records} records, {status.dropped} dropped.</p>'
    return (
        f"{gauges([('Used', used, space.total_bytes, f'{size(space.free_bytes)} free')])}"
        f'<p><b>{full}</b></p><p class="small">{escape(space.path)}, {size(keep)} are kept free, {then}. '
        f'<a href="/logs/">Browse the logs</a></p>{log}'
    )


def networks(view: PageView) -> str:
    found = view.report.computer
    if found is None:
        return '<p class="none">no data yet</p>'
    up = "".join(_network(name, each) for name, each in found.networks.items() if each.up)
    down = ", ".join(escape(name) for name, each in found.networks.items() if not each.up and each.received_bytes)
    return f'<ul class="services">{up}</ul>' + (f'<p class="small">No longer up: {down}</p>' if down else "")


def _network(name: str, network: Network) -> str:
    rates = f"in {rate(network.received_bps)} · out {rate(network.sent_bps)}"
    totals = f"{size(network.received_bytes)} in, {size(network.sent_bytes)} out"
    bad = f" · {network.errors} errors, {network.dropped} dropped" if network.errors or network.dropped else ""
    addresses = escape(", ".join(network.addresses))
    return f'<li><b class="name">{escape(name)}</b> {addresses}<span class="small">{rates} · {totals}{bad}</span></li>'


def clock(view: PageView) -> str:
    """The computer's clock beside that of the satellites."""
    report, vehicle = view.report, view.report.vehicle
    now = datetime.fromtimestamp(report.utc_ns // 1_000_000_000, UTC)
    told = [f"{now:%Y-%m-%d}"]
    if report.computer is not None and (error_s := report.computer.time.error_s) is not None:
        told.append(f"another program keeps it to {span(error_s)}")
    age_s = vehicle.age_s.get("navigation") if vehicle else None
    if vehicle is not None and vehicle.utc_ns and age_s is not None:
        off_s = (report.utc_ns - vehicle.utc_ns) / 1e9 - age_s
        told.append(f"{off_s:+.1f} s off navigation’s, by {escape(vehicle.source)}")
    else:
        told.append("navigation gives no time to compare with")
    if vehicle is not None and (kept := vehicle.clock).kept:
        source = f", compared with {kept.source}" if kept.source else ""
        off = f", {kept.off_s:+.3f} s off it" if kept.off_s is not None else ""
        told += [escape(f"{kept.kept}{source}{off}"), *([f"<b>{escape(kept.fault)}</b>"] if kept.fault else [])]
    return f'<p class="big">{now:%H:%M:%S} <small>UTC</small></p><p class="small">{" · ".join(told)}</p>'


def processes(view: PageView) -> str:
    found = view.report.computer
    if found is None:
        return '<p class="none">no data yet</p>'
    rows = "".join(
        f"<tr><td>{each.pid}</td><th>{escape(each.name)}</th><td>{each.cpu:.1%}</td><td>{size(each.memory_bytes)}</td>"
        f"<td>{each.nice}</td></tr>"
        for each in found.processes
    )
    shown = f"The busiest {len(found.processes)} of {found.process_count}."
    names = "<tr><th>id</th><th>name</th><th>cpu</th><th>memory</th><th>nice</th></tr>"
    return f'<table class="processes"><thead>{names}</thead>{rows}</table><p class="small">{shown}</p>'


def vessels(view: PageView) -> str:
    """Other vessels: how many, how long ago, what the boat does for them, and those that matter first. The line stands there
    always: silence is no clear water."""
    traffic = view.report.vehicle.traffic if view.report.vehicle else None
    if traffic is None:
        return f'<p class="none">Nobody was heard. {SEES}</p>'
    heard = f"last report {span(traffic.heard_s)} ago" if traffic.heard_s is not None else "nobody was heard"
    told = [f"{len(traffic.targets)} vessel{'' if len(traffic.targets) == 1 else 's'}, {heard}. {SEES}"]
    if traffic.order is not None:
        told.append(f"<b>{escape(traffic.order.words)}</b>")
    told.append(f"Keeps clear of them: {escape(traffic.guard)}")
    shown = sorted(traffic.targets, key=_first_met)[:VESSELS_MAX]
    names = "<tr><th>name</th><th>CPA</th><th>in</th><th>course</th><th>speed</th><th>age</th></tr>"
    table = f'<table class="processes"><thead>{names}</thead>{"".join(map(_vessel, shown))}</table>' if shown else ""
    more = f'<p class="small">and {len(traffic.targets) - len(shown)} more</p>' if len(traffic.targets) > len(shown) else ""
    return f'<p class="small">{"<br/>".join(told)}</p>{table}{more}'


def _vessel(vessel: VesselSeen) -> str:
    name = escape(vessel.name if vessel.size_known else f"{vessel.name} (size unknown)")
    bad = vessel.danger != "none"
    tcpa = "–" if vessel.tcpa_s is None else "past" if vessel.tcpa_s < 0.0 else span(vessel.tcpa_s)
    age = f"{'lost, ' if vessel.lost else ''}{span(vessel.age_s)}"
    course = "–" if vessel.course_deg is None else f"{vessel.course_deg:03.0f}°"
    cells = "–" if vessel.cpa_m is None else f"{vessel.cpa_m:.0f} m", tcpa, course, f"{vessel.speed_mps:.1f} m/s", age
    shown = f"<b>{name}: {escape(vessel.danger)}</b>" if bad else name
    return f"<tr><th>{shown}</th>{''.join(f'<td>{each}</td>' for each in cells)}</tr>"


def _first_met(vessel: VesselSeen) -> tuple[int, float]:
    """Dangerous ones, then those that draw near by their time, then those that draw apart."""
    tcpa_s = vessel.tcpa_s if vessel.tcpa_s is not None else float("inf")
    return {"danger": 0, "near": 1}.get(vessel.danger, 2 if tcpa_s >= 0.0 else 3), abs(tcpa_s)


# The page, in its order.
SECTIONS: Final = (
    Section("motion", "Motion", motion, 1.0, 0),
    Section("where", "Where", where, 1.0, 0),
    Section("warnings", "To look at", warnings, 1.0, 0),
    Section("vessels", "Other vessels", vessels, 1.0, 0),
    Section("inputs", "Age of every input", inputs, 1.0, 0),
    Section("disk", "Logs", disk, 5.0, 0),
    Section("latency", "Critical path", latency, 5.0, 1),
    Section("stages", "Stages of a cycle", stages, 5.0, 1),
    Section("services", "Services", services, 5.0, 1),
    Section("buses", "CAN", buses, 5.0, 1),
    Section("computer", "Computer", computer, 5.0, 2),
    Section("networks", "Network", networks, 5.0, 2),
    Section("clock", "Clock", clock, 1.0, 2),
    Section("processes", "Processes", processes, 5.0, 2),
    Section("log", "System log", lambda view: last_words(view.report.computer), 5.0, 2),
)
