# The packages' life in a clean root of Debian, as process 1 of a namespace with a network of its own: installed, started, upgraded,
# removed, purged. Ends at the first thing that is not as it should be. $1, $2: delfim, delfim-ground; $3: a newer delfim.
set -e
FILE=/etc/delfim/vehicle.toml
SIM=/tmp/sim
export DEBIAN_FRONTEND=noninteractive LANG=C.UTF-8 PATH=/usr/sbin:/usr/bin:/sbin:/bin
trap 'status=$?; [ $status = 0 ] || { echo "life: not as it should be: $step" >&2; tail -n 40 /tmp/apt /tmp/said /run/delfim/output; } 2>/dev/null; exit $status' EXIT

mount -t proc proc /proc
mount -t tmpfs run /run
mount -t devpts devpts /dev/pts
ip link set lo up
# What init would have written: this is runlevel 2. Without it invoke-rc.d starts nothing.
python3 -c 'import struct; open("/run/utmp", "wb").write(struct.pack("<hxxi", 1, ord("2")).ljust(384, b"\0"))'

begin() { step=$*; echo "== $(cut -d. -f1 /proc/uptime) s: $step"; }
fails() { if "$@"; then return 1; fi; } # set -e does not see what follows a !
apt() { apt-get -y "$@" >/tmp/apt 2>&1; }
until_s() { # seconds, words: until they succeed
    limit=$(($(cut -d. -f1 /proc/uptime) + $1)) && shift
    until "$@" >/dev/null 2>&1; do [ "$(cut -d. -f1 /proc/uptime)" -lt $limit ]; sleep 0.2; done
}
state() { delfim drive $FILE state; }
mode() { state | grep -q "^$1"; }
running() { service delfim status >/dev/null; }
programs() { grep -lsaE 'delfim.(supervise|run)' /proc/[0-9]*/cmdline | wc -l; }

begin installed: the group, /log, bytecode, the service in its runlevels, and no boat without a file
apt install "$1" "$2"
getent group delfim >/dev/null
[ -d /log ]
[ ! -e $FILE ]
[ "$(find /opt/delfim -name 'loop.*.pyc' | wc -l)" = 1 ]
ls /etc/rc2.d/S??delfim /etc/rc0.d/K??delfim >/dev/null
fails running

begin the simulation sails, and its page is in the browser, without root and without a file
setsid su nobody -s /bin/sh -c "HOME=/tmp exec delfim sim --console --plain --output $SIM" >/tmp/said 2>&1 &
sim=$!
page() { python3 -c 'import re, sys, urllib.request as ask
page = ask.urlopen(re.search(r"http://127\S+token=[\w-]+", open("/tmp/said").read())[0], timeout=5)
sys.exit(b"console.js" not in page.read())'; }
until_s 120 page
kill -INT -$sim
wait $sim || true

begin without delfim-ground the boat stays
apt remove delfim-ground
[ ! -e /opt/delfim/lib/python3.*/site-packages/matplotlib ]
delfim check /delfimx.toml >/dev/null

begin started: sockets for the group
sed 's/interface = "can0"/interface = "canloop:life"/' /delfimx.toml >$FILE
digest=$(sha256sum $FILE)
service delfim start
until_s 60 state
[ "$(stat -c '%U:%G %a' /run/delfim/command)" = "root:delfim 660" ]
running

begin under way: an upgrade is refused, and the boat sails on
delfim nodes $FILE >/dev/null 2>&1 &
has_heading() { state | grep -q 'heading [0-9]'; }
until_s 60 has_heading
{ until mode heading; do echo heading 90 0.5; sleep 1; done; sleep 1000; } | delfim drive $FILE >/dev/null &
until_s 60 mode heading
fails apt install "$3"
grep -q 'under way, in mode heading' /tmp/apt
mode heading
dpkg-query -W -f '${Status}' delfim | grep -q '^install ok installed$'

begin upgraded in idle: another boat runs, the file is as it was
delfim drive $FILE stop >/dev/null
before=$(cat /run/delfim/init.pid)
until_s 30 mode idle
apt install "$3"
until_s 60 state
[ "$before" != "$(cat /run/delfim/init.pid)" ]
[ "$digest" = "$(sha256sum $FILE)" ]

begin removed: nothing runs, file and logs are there, the script that is left does nothing
apt remove delfim
[ "$(programs)" = 0 ]
[ ! -e /opt/delfim ]
[ ! -e /usr/bin/delfim ]
[ "$digest" = "$(sha256sum $FILE)" ]
[ -n "$(find /log -path '*/state/*' -type f)" ]
/etc/init.d/delfim start

begin installed again: the boat starts
apt install "$1"
until_s 60 state

begin purged: settings are gone, the file and the logs are the owner\'s
apt purge delfim
[ "$(programs)" = 0 ]
[ "$(ls -d /etc/default/delfim /etc/init.d/delfim /etc/rc2.d/S??delfim 2>/dev/null)" = "" ]
[ "$digest" = "$(sha256sum $FILE)" ]
[ -n "$(find /log -path '*/state/*' -type f)" ]
[ "$(dpkg-query -W -f '${Package}\n' 'delfim*' 2>/dev/null)" = "" ]
begin all is as it should be
