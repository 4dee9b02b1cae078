"""Inside the guest: a full bus into the black box for so many seconds, and then for at most a minute into `candump | gzip`.

python tests/guest/guest_blackbox.py FEEDER FRAMES_PER_S SECONDS        prints what each saw and what it cost as one JSON object
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from delfim.logging.liblog import in_order
from delfim.logging.reading import read_log

FOLDER = Path(os.environ["FOLDER"])
LOG = Path("/dev/shm/log")  # memory: it is the programs that are measured
FEEDER, FRAMES_PER_S, SECONDS = sys.argv[1], sys.argv[2], float(sys.argv[3])
NO_PRIORITY = ("setpriv", "--bounding-set", "-sys_nice")  # a guest has one processor, and the feeder would keep it
IDLE, IDLE_S = 0.1, 1.0  # who took less of a core for so long has nothing to do
TICK_S = 1 / os.sysconf("SC_CLK_TCK")
SETTINGS = {
    "can.interface": '"vcan0"',
    "can.receive_buffer_bytes": str(64 << 20),  # what the host does beside is no loss of canzlogd's
    "log.directory": f'"{LOG}"',
    "log.free_bytes_min": "0",
    "runtime.run_directory": f'"{FOLDER}"',
}


def started(*command: str) -> "subprocess.Popen[bytes]":
    with (FOLDER / "programs.out").open("ab") as output:
        return subprocess.Popen(command, stdout=output, stderr=output)


def family(pid: int) -> list[int]:
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return [pid, *(one for child in children for one in family(int(child)))]


def comm(pid: int) -> str:
    return Path(f"/proc/{pid}/comm").read_text().strip()


def cpu_s(pids: list[int]) -> float:
    """Of these processes, which are all alive."""
    fields = [Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split() for pid in pids]
    return sum(int(each[11]) + int(each[12]) for each in fields) * TICK_S


def until(true: object, what: str) -> None:
    for _ in range(600):
        if true():
            return
        time.sleep(0.1)
    raise SystemExit(f"{what}\n{(FOLDER / 'programs.out').read_text(errors='replace')[-3000:]}")


def flooded(program: "subprocess.Popen[bytes]", seconds: float) -> tuple[dict[str, Any], float]:
    """What the feeder says that it sent, and the share of a core that the program and its children took for that."""
    time.sleep(1.0)
    pids = family(program.pid)
    before_s = cpu_s(pids)
    command = [*NO_PRIORITY, FEEDER, "vcan0", "5", "0", str(seconds), FRAMES_PER_S, "0"]
    told = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    spent_s = [0.0]
    while (now_s := cpu_s(pids) - before_s) > spent_s[-1] + IDLE * IDLE_S:  # it may be behind
        spent_s.append(now_s)
        time.sleep(IDLE_S)
    return told, spent_s[-1] / told["frames"] * float(FRAMES_PER_S)


def ours() -> dict[str, Any]:
    words = [word for key, value in SETTINGS.items() for word in ("--set", f"{key}={value}")]
    box = started(sys.executable, "-m", "delfim", "run", "etc/delfimx.toml", "--service", "canzlogd", *words)
    until(lambda: list(LOG.glob("*/vcan0/*.log.gz")), "canzlogd did not start")
    fed, share = flooded(box, SECONDS)
    box.send_signal(signal.SIGTERM)
    box.wait(30)
    logs = in_order(LOG.glob("*/vcan0/*.log.gz"))
    frames, numbered, are_in_order = 0, 0, True
    for path in logs:
        lines = read_log(path)[0].decode()
        frames += lines.count("\n")
        for match in re.finditer(r" 4[0-3].#([0-9A-F]{16}) ", lines):
            are_in_order &= int.from_bytes(bytes.fromhex(match[1]), "little") == numbered
            numbered += 1
    return {
        "sent": fed["frames"],
        "unsent": fed["unsent"],
        "late_us_max": fed["late_us_max"],
        "logged": frames,
        "in_order": are_in_order and numbered > 0,
        "files": len(logs),
        "core_share": round(share, 4),
        "sidecars": "".join(path.read_text() for path in LOG.glob("*/vcan0/*.meta.jsonl")),
    }


def theirs() -> dict[str, Any]:
    shell = started("/bin/sh", "-c", "candump -L -r 67108864 vcan0 | gzip >/dev/shm/candump.gz")
    until(lambda: len(family(shell.pid)) == 3, "candump did not start")
    fed, share = flooded(shell, min(SECONDS, 60.0))
    os.kill(next(pid for pid in family(shell.pid) if comm(pid) == "candump"), signal.SIGINT)
    shell.wait(30)
    lines = subprocess.check_output(["zcat", "/dev/shm/candump.gz"]).count(b"\n")
    return {"candump_sent": fed["frames"], "candump_logged": lines, "candump_core_share": round(share, 4)}


print("REPORT " + json.dumps(ours() | theirs()))
