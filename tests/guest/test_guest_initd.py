"""etc/init.d/delfim, for boards that keep their init: start, status, restart, stop, and a suite that died. What the script does
with any program is in tests/services/test_initd.py.
"""

import pytest

from tests.guest.harness import ROOT, Guest

SETTINGS = """
VEHICLE=$FOLDER/board.toml DELFIM="python -m delfim" RUN=/run/board
"""


@pytest.mark.long
def test_start_status_restart_stop(can_guest: Guest) -> None:
    text = (ROOT / "etc/delfimx.toml").read_text()
    text = text.replace('interface = "can0"', 'interface = "vcan0"').replace('"/log"', '"/run/board/log"')
    text += '\n[runtime]\nrun_directory = "/run/board"\n[console]\nsocket = "/run/board/command"\n'
    text += "[services.httpd]\nenabled = false\n"
    (can_guest.folder / "board.toml").write_text(text)
    (can_guest.folder / "default").write_text(SETTINGS)
    script = f"{ROOT}/etc/init.d/delfim"
    # This start logs: what is told to end while its writers are still starting may take too long for that, and is killed.
    logs = "find /run/board/log -name '*.state*' -newer /run/board/init.pid | grep -q ."
    up = f"until {logs}; do sleep 0.1; done\n"
    result = can_guest.run(
        'mkdir -p /etc/default; cp "$FOLDER/default" /etc/default/delfim\n'
        f"ask() {{ {script} $1; echo $1 $?; }}\n"
        f"ask status; ask start; ask start; ask status; {up}\n"
        "before=$(cat /run/board/init.pid); ask restart; [ $(cat /run/board/init.pid) != $before ] && echo another one\n"
        f"{up} ask stop; ask stop; ask status; ls /run/board/log/running 2>&1 && cat /run/board/output\n"
        f"ask start; {up} kill -9 $(cat /run/board/init.pid); until ask status | grep died; do sleep 0.1; done; ask nonsense\n"
        "while grep -qsa 'delfim[^ ]run' /proc/[0-9]*/cmdline; do sleep 0.1; done\n"  # it ends in order, without its supervisor
        "rm /etc/default/delfim",
        timeout_s=110.0,
    )
    lines = result.output.splitlines()
    assert [line for line in lines if line.split()[0] in ("status", "start", "restart", "stop", "nonsense")] == [
        "status 3",
        "start 0",
        "start 0",
        "status 0",
        "restart 0",
        "stop 0",
        "stop 0",
        "status 3",
        "start 0",
        "nonsense 2",
    ], result.output
    assert "another one" in lines
    assert "delfim runs already" in lines
    assert "delfim died; its last words are in /run/board/output" in lines
    assert any("No such file" in line for line in lines), f"an end in order leaves no mark behind: {result.output}"
