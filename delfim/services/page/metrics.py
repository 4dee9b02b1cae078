"""/metrics: the data in the form of Prometheus (text exposition format 0.0.4). Base units, names as its guide asks for."""

from collections.abc import Iterable, Iterator
from typing import Final, NamedTuple

from delfim.services.page.api import Report
from delfim.vehicle.report import LatencyFacts

CONTENT_TYPE: Final = "text/plain; version=0.0.4; charset=utf-8"
BUCKETS_US: Final = (10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000, 100_000, 1_000_000)

Sample = tuple[dict[str, str], float]  # labels, value


class Metric(NamedTuple):
    name: str
    kind: str  # gauge, counter
    help: str
    samples: Iterable[Sample]


def metrics(report: Report) -> str:
    lines: list[str] = []
    for metric in [*_vehicle(report), *_services(report), *_computer(report), *_server(report)]:
        lines += (f"# HELP {metric.name} {metric.help}", f"# TYPE {metric.name} {metric.kind}")
        lines += (f"{metric.name}{_labels(labels)} {value:.10g}" for labels, value in metric.samples)
    if report.vehicle is not None:
        lines += _path(report.vehicle.latency)
    return "\n".join(lines) + "\n"


def _vehicle(report: Report) -> Iterator[Metric]:
    vehicle = report.vehicle
    yield Metric("delfim_up", "gauge", "Whether the vehicle answers.", [({}, vehicle is not None)])
    if vehicle is None:
        return
    ages = [({"input": name}, age) for name, age in vehicle.age_s.items() if age is not None]
    payload = {"payload": vehicle.helmsman} if vehicle.helmsman else {}
    yield Metric("delfim_mode", "gauge", "The present mode is 1.", [({"mode": vehicle.mode} | payload, 1)])
    yield Metric("delfim_input_age_seconds", "gauge", "Age of each input; an input that was never heard is missing.", ages)
    yield Metric("delfim_notices", "gauge", "Troubles the failsafe sees.", [({}, len(vehicle.notices))])
    faulty = [({"node": name}, float(node.status != "good")) for name, node in vehicle.sysstat.items()]
    yield Metric("delfim_node_bad", "gauge", "Whether a CAN node reports anything but good.", faulty)
    measured = [({"value": name}, value) for name, value in vehicle.measured.items() if value is not None]
    yield Metric("delfim_measured", "gauge", "Last value of each sensor, its name ends with the unit; see its age.", measured)
    events = [({"event": name}, float(n)) for name, n in vehicle.counts.items()]
    parts = [({"part": name}, health) for name, health in vehicle.parts.items()]
    if parts:
        failed, worst = "Calls to a laboratory's part that failed.", "The longest call to a laboratory's part."
        yield Metric("delfim_part_calls_failed_total", "counter", failed, [(labels, each.failed) for labels, each in parts])
        yield Metric("delfim_part_call_worst_seconds", "gauge", worst, [(labels, each.worst_s) for labels, each in parts])
    yield Metric("delfim_events_total", "counter", "Inputs that were refused, dropped or repaired.", events)
    for name, value, text in (
        ("delfim_heading_degrees", vehicle.heading_deg, "True heading."),
        ("delfim_speed_metres_per_second", vehicle.speed_mps, "Speed over ground."),
        ("delfim_latitude_degrees", vehicle.latitude_deg, "WGS 84."),
        ("delfim_longitude_degrees", vehicle.longitude_deg, "WGS 84."),
    ):
        yield Metric(name, "gauge", text, [] if value is None else [({}, value)])
    clock = vehicle.clock
    off = [] if clock.off_s is None else [({"source": clock.source}, clock.off_s)]
    yield Metric("delfim_clock_offset_seconds", "gauge", "The computer's clock minus the time of its source.", off)
    yield Metric("delfim_clock_fault", "gauge", "Whether a time is not taken.", [({}, bool(clock.fault))])
    rows = vehicle.thrusters.items()
    thrust = [({"thruster": name}, each.thrust) for name, each in rows]
    yield Metric("delfim_thruster_command_ratio", "gauge", "As commanded, -1 to 1.", thrust)
    rpm = [({"thruster": name}, each.rpm) for name, each in rows if each.rpm is not None]
    yield Metric("delfim_thruster_rpm", "gauge", "As reported.", rpm)
    charged = [({"node": name}, node.charge) for name, node in vehicle.sysstat.items() if node.charge is not None]
    yield Metric("delfim_battery_charge_ratio", "gauge", "0 to 1.", charged)
    yield Metric("delfim_log_records_dropped_total", "counter", "Of the state log.", [({}, vehicle.log.dropped)])


def _path(latency: LatencyFacts) -> Iterator[str]:
    name = "delfim_critical_path_seconds"
    yield f"# HELP {name} From the kernel's receive time of navigation to the command of the propellers."
    yield f"# TYPE {name} histogram"
    for limit_us in BUCKETS_US:
        upto = sum(n for edge, n in latency.histogram if edge <= 1.03 * limit_us)  # bars end on whole microseconds
        yield f'{name}_bucket{{le="{limit_us / 1e6:g}"}} {upto}'
    means_us = sum(mean for stage, mean in latency.stages_us.items() if stage != "log")
    yield f'{name}_bucket{{le="+Inf"}} {latency.n}'
    yield f"{name}_sum {means_us * latency.n / 1e6:.9g}"
    yield f"{name}_count {latency.n}"


def _services(report: Report) -> Iterator[Metric]:
    supervisor = report.computer.supervisor if report.computer else {}
    known = {**supervisor, **report.services}
    up = [({"service": name, "place": each.place}, float(each.state == "running")) for name, each in known.items()]
    yield Metric("delfim_service_up", "gauge", "Whether a service runs.", up)
    restarts = [({"service": name}, float(each.restarts)) for name, each in known.items()]
    yield Metric("delfim_service_restarts_total", "counter", "Starts after the first one.", restarts)
    cooperative = report.services.items()
    busy = [({"service": name}, each.busy_s) for name, each in cooperative]
    yield Metric("delfim_service_busy_seconds_total", "counter", "Time of the loop that its callbacks took.", busy)
    longest = [({"service": name}, each.longest_callback_s) for name, each in cooperative]
    yield Metric("delfim_service_longest_callback_seconds", "gauge", "Since it was started.", longest)
    over = [({"service": name}, float(each.over_budget)) for name, each in cooperative]
    yield Metric("delfim_service_callbacks_over_budget_total", "counter", "Longer than the vehicle's file allows.", over)


def _computer(report: Report) -> Iterator[Metric]:
    computer = report.computer
    if computer is None:
        return
    cpu = [({"cpu": str(n)}, share) for n, share in enumerate(computer.cpu)]
    yield Metric("delfim_cpu_busy_ratio", "gauge", "Of each processor, since the last look.", cpu)
    yield Metric("delfim_uptime_seconds", "gauge", "Of the computer.", [({}, computer.uptime_s)])
    yield Metric("delfim_memory_available_bytes", "gauge", "Of the computer.", [({}, computer.memory.available_bytes)])
    yield Metric("delfim_memory_total_bytes", "gauge", "Of the computer.", [({}, computer.memory.total_bytes)])
    if computer.disk is not None:
        yield Metric("delfim_log_free_bytes", "gauge", "Of the partition of the logs.", [({}, computer.disk.free_bytes)])
        full: list[Sample] = [] if computer.disk.full_in_s is None else [({}, computer.disk.full_in_s)]
        yield Metric(
            "delfim_log_full_seconds", "gauge", "Until it is full at this rate; missing while it is not filling.", full
        )
    for way in ("received", "sent"):
        total = [({"interface": name}, float(getattr(each, f"{way}_bytes"))) for name, each in computer.networks.items()]
        yield Metric(f"delfim_network_{way}_bytes_total", "counter", "Of each network interface.", total)
    for name, text in (("frames", "Seen on"), ("dropped", "Dropped on"), ("errors", "Errors of"), ("bus_off", "Bus off of")):
        counts = [({"bus": bus}, float(getattr(each, name))) for bus, each in computer.buses.items()]
        yield Metric(f"delfim_can_{name}_total", "counter", f"{text} each CAN controller.", counts)
    load = [({"bus": name}, each.load) for name, each in computer.buses.items() if each.load is not None]
    yield Metric("delfim_can_load_ratio", "gauge", "Of each bus, since the last look.", load)


def _server(report: Report) -> Iterator[Metric]:
    server = report.server
    yield Metric("delfim_http_connections", "gauge", "To this server, now.", [({}, server.connections)])
    yield Metric("delfim_http_requests_total", "counter", "To this server.", [({}, server.requests)])
    yield Metric("delfim_http_refused_total", "counter", "Connections beyond the limits.", [({}, server.refused)])


def _labels(labels: dict[str, str]) -> str:
    if not labels:
        return ""
    return "{" + ",".join(f'{name}="{_escaped(value)}"' for name, value in labels.items()) + "}"


def _escaped(value: str) -> str:
    return value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
