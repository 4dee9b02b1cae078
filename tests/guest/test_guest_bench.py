"""The C programs of the benchmark on the kernel's own CAN: the feeder sends navigation and other traffic, the loop answers."""

import json

import pytest

from bench.critical_path import build
from delfim.logging.statelog import columns
from tests.guest.harness import Guest

# Who listens is seen in the kernel's lists of receivers.
SCRIPT = """
listening() {{ cat /proc/net/can/rcvlist_* | grep -c ' vcan1 '; }}
{loop} vcan1 {log} & until [ $(listening) -gt 0 ]; do sleep 0.1; done
before=$(listening); candump -L vcan1 >{frames} & until [ $(listening) -gt $before ]; do sleep 0.1; done
{feeder} vcan1 50 0.2 1 500 0; code=$?
for tenth in $(seq 100); do [ $(grep -cE ' 04[0-3]#' {frames}) -ge 240 ] && break; sleep 0.1; done
kill %1 %2; exit $code
"""


@pytest.mark.long
def test_c_programs_on_a_real_bus(can_guest: Guest) -> None:
    programs = build(can_guest.folder)
    log, frames = can_guest.folder / "c.state", can_guest.folder / "frames"
    result = can_guest.run(SCRIPT.format(**programs, log=log, frames=frames), timeout_s=30.0)
    assert result.code == 0, result.output
    told = json.loads(result.output[result.output.index("{") : result.output.index("}") + 1])
    data = columns([log])
    assert told["messages"] == len(data["t0"]) == 60
    assert data["counter"] == list(range(60))
    assert all(t0 <= t2 <= t3 <= t4 for t0, t2, t3, t4 in zip(*(data[name] for name in ("t0", "t2", "t3", "t4")), strict=True))
    lines = frames.read_text().splitlines()
    for identifier in ("040", "041", "042", "043"):
        told = [line.split("#")[1] for line in lines if f" {identifier}#" in line]
        assert len(set(told)) >= 60, "each once; a loop that waited long repeats its command, with a new number"
