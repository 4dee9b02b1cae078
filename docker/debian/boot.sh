#!/bin/sh
# The package's life on a computer whose process 1 is systemd: installed, started, killed, starved of memory, stopped, upgraded; after
# the second boot: there by itself, removed, purged. Ends at the first thing that is not as it should be, and the computer with it.
# $1: delfim; $2: a newer one.
set -e
FILE=/etc/delfim/vehicle.toml
export DEBIAN_FRONTEND=noninteractive LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root
exec >/dev/console 2>&1
ended() {
    status=$?
    set +e
    if [ $status = 0 ]; then
        echo "boot: as it should be"
    else
        echo "boot: not as it should be: $step"
        tail -n 20 /tmp/apt
        systemctl --no-pager status delfim
        said -b -n 40
    fi
    systemctl --no-block start poweroff.target
}
trap 'ended' EXIT

begin() { step=$*; echo "== $(cut -d. -f1 /proc/uptime) s: $step"; }
fails() { if "$@"; then return 1; fi; } # set -e does not see what follows a !
apt() { apt-get -y "$@" >/tmp/apt 2>&1; }
until_s() { # seconds, words: until they succeed
    limit=$(($(cut -d. -f1 /proc/uptime) + $1)) && shift
    until "$@" >/dev/null 2>&1; do [ "$(cut -d. -f1 /proc/uptime)" -lt $limit ]; sleep 0.5; done
}
state() { delfim drive $FILE state; }
mode() { state | grep -q "^$1"; }
of() { systemctl show --value -p "$1" delfim; }
said() { journalctl -u delfim -o cat "$@"; }
pids() { grep -lsaE 'delfim.(supervise|run)' /proc/[0-9]*/cmdline | cut -d/ -f3; }
service_of() { # its process
    for pid in $(pids); do tr '\0' ' ' <"/proc/$pid/cmdline" | grep -q -e "--service $1 " && echo "$pid" && return; done
    return 1
}
there() { [ "$(of ActiveState)" = active ] && state; }
heading() { # the simulated boat sails
    delfim nodes $FILE >/dev/null 2>&1 &
    nodes=$!
    has_heading() { state | grep -q 'heading [0-9]'; }
    until_s 60 has_heading
    { until mode heading; do echo heading 90 0.5; sleep 1; done; sleep 1000; } | delfim drive $FILE >/dev/null &
    until_s 60 mode heading
}
not_before() { [ "$(of MainPID)" != "$1" ] && there; }

if [ ! -e /first ]; then
    begin installed: enabled, and no boat without a file, which is no failure
    apt install "$1"
    systemctl is-enabled --quiet delfim
    systemctl start delfim
    [ "$(of ActiveState) $(of Result)" = "inactive exec-condition" ]

    begin a file that is wrong: not started, the reason in the journal, and tried again
    echo 'boat = 1' >$FILE
    fails systemctl start delfim
    said | grep -q boat
    tried_again() { [ "$(of NRestarts)" -gt 5 ]; }
    until_s 120 tried_again

    begin put right: started by itself, sockets for the group, words in the journal
    # A fault that an operator cannot cause: an exception in the supervisor.
    fault=$(echo /opt/delfim/lib/python3.*/site-packages)/fault.pth
    echo 'import signal; signal.signal(signal.SIGUSR2, lambda *_: 1 / 0)' >"$fault"
    sed 's/interface = "can0"/interface = "canloop:life"/' /delfimx.toml >/tmp/boat.toml
    printf '\n[services.httpd]\nplace = "process"\nmemory_max_mb = 128\n' >>/tmp/boat.toml
    mv /tmp/boat.toml $FILE
    until_s 90 there
    [ "$(stat -c '%U:%G %a' /run/delfim/command)" = "root:delfim 660" ]
    service delfim status >/dev/null

    begin killed: the supervisor is started again, nothing of before is left
    before=$(of MainPID) old=$(pids) restarts=$(of NRestarts)
    kill -KILL "$before"
    until_s 60 not_before "$before"
    [ "$(of NRestarts)" = $((restarts + 1)) ]
    for pid in $old; do fails [ -s "/proc/$pid/cmdline" ]; done
    fails said -b --grep 'signal SIGKILL' >/tmp/said # they ended in order: whoever drives motors has stopped them

    begin an exception in the supervisor: it ends the boat in order, says why, and is started again
    before=$(of MainPID)
    kill -USR2 "$before"
    until_s 60 not_before "$before"
    said -b | grep -q ZeroDivisionError
    fails said -b --grep 'signal SIGKILL' >/tmp/said
    rm "$fault"

    begin limited and starved of memory: the kernel kills one program, the supervisor starts that one again, and the boat stays
    [ "$(cat /sys/fs/cgroup/delfim/httpd/memory.max)" = $((128 << 20)) ]
    [ -n "$(cat /sys/fs/cgroup/delfim/httpd/cgroup.procs)" ]
    until_s 60 service_of syslogd
    before=$(of MainPID) victim=$(service_of syslogd)
    echo 1000 >"/proc/$victim/oom_score_adj"
    echo f >/proc/sysrq-trigger
    another() { service_of syslogd && [ "$(service_of syslogd)" != "$victim" ]; }
    until_s 60 another
    said -b | grep -q 'killed by the OOM killer'
    [ "$(of MainPID) $(of ActiveState)" = "$before active" ]

    begin under way: an upgrade is refused, and the boat sails on
    heading
    fails apt install "$2"
    grep -q 'under way, in mode heading' /tmp/apt
    mode heading

    begin stopped under way: in order
    systemctl stop delfim
    [ "$(of Result)" = success ]
    [ "$(pids)" = "" ]
    fails service delfim status >/dev/null
    said -b | grep -q 'runtime: stopping: SIGTERM'
    fails said -b --grep 'signal SIGKILL' >/tmp/said
    kill $nodes

    begin restarted, upgraded in idle: another boat runs
    systemctl restart delfim
    until_s 60 there
    before=$(of MainPID)
    apt install "$2"
    until_s 60 not_before "$before"

    begin the computer is switched off
    touch /first
else
    begin started again: the boat is there by itself, and ended in order before
    until_s 90 there
    said -b -1 | grep -q 'runtime: stopping: SIGTERM'
    fails said -b -1 --grep 'signal SIGKILL|timed out' >/tmp/said

    begin disabled: an upgrade leaves it so
    systemctl disable --now delfim
    apt install --reinstall "$2"
    fails systemctl is-enabled --quiet delfim
    systemctl enable --now delfim
    until_s 60 there

    begin removed and purged: nothing runs, the unit is gone, the file stays
    apt remove delfim
    systemctl start delfim # the script that is left
    [ "$(pids)" = "" ]
    apt purge delfim
    fails systemctl cat delfim >/dev/null 2>&1
    [ "$(find /etc/systemd /var/lib/systemd -name 'delfim*')" = "" ]
    [ -e $FILE ]
fi
