# A package's life in a clean root of Debian, as process 1 of a namespace with a network of its own; tests/test_debian.py reads
# what it says. $1: the file of etc/, $2: packages, $3: newer packages.
mount -t proc proc /proc
mount -t tmpfs run /run
mount -t devpts devpts /dev/pts
ip link set lo up
export DEBIAN_FRONTEND=noninteractive LANG=C.UTF-8
FILE=/etc/delfim/vehicle.toml
say() { echo "== $*"; }
alive() { grep -lsaE 'delfim.(supervise|run)' /proc/[0-9]*/cmdline | wc -l; }
up() { for try in $(seq 300); do [ -S /run/delfim/command ] && delfim drive $FILE state >/dev/null 2>&1 && return; sleep 0.1; done; say "does not come up"; cat /run/delfim/output; }

apt-get install -y $2
say "installed $?, group $(getent group delfim | cut -d: -f1), log $(ls -d /log)"
[ -e $FILE ] || say "no vehicle's file"
say "compiled $(find /opt/delfim -name 'loop.*.pyc' | wc -l)"

# Who simulates needs neither root nor a file.
cd /tmp
setsid su nobody -s /bin/sh -c 'HOME=/tmp delfim sim --console --plain --output /tmp/sim' >/tmp/said 2>&1 &
sim=$!
python3 - <<'P'
import re, time, urllib.request
until_s = time.monotonic() + 60
while time.monotonic() < until_s:
    said = open("/tmp/said").read()
    found = re.search(r"http://127\S+token=[\w-]+", said)
    if found:
        try:
            answer = urllib.request.urlopen(found[0], timeout=5)
            print("== page", answer.status, "console.js" in answer.read().decode())
            break
        except OSError as error:
            last = error
    time.sleep(0.2)
else:
    print("== no page", said)
P
kill -INT -$sim
wait $sim
apt-get remove -y delfim-ground
say "without the console $?, $(dpkg-query -W -f '${Status}' delfim)"

# A boat, without hardware.
sed 's/interface = "can0"/interface = "canloop:life"/' "$1" >$FILE
digest=$(sha256sum $FILE)
service delfim start
up
say "started, socket of $(stat -c '%U:%G %a' /run/delfim/command), status $(service delfim status)"
delfim nodes $FILE >/dev/null 2>&1 & # what is on its bus
until delfim drive $FILE state | grep -q 'heading [0-9]'; do sleep 0.1; done
{ echo manual 0.2 0.2; sleep 1000; } | delfim drive $FILE &
for try in $(seq 100); do delfim drive $FILE state | grep -q manual && break; sleep 0.1; done
apt-get install -y $3 2>&1
say "upgrade under way $?, $(dpkg-query -W -f '${Status} ${Version}' delfim)"
say "still $(delfim drive $FILE state | grep -o '^manual')"
delfim drive $FILE stop
before=$(cat /run/delfim/init.pid)
apt-get install -y $3
say "upgrade $?, $(dpkg-query -W -f '${Status} ${Version}' delfim)"
up
[ "$before" != "$(cat /run/delfim/init.pid)" ] && say "another boat runs: $(service delfim status)"
[ "$digest" = "$(sha256sum $FILE)" ] && say "vehicle's file untouched"

apt-get remove -y delfim
say "removed $?, programs of the boat $(alive), opt $(ls -d /opt/delfim 2>&1)"
/etc/init.d/delfim start
say "script left behind $?, file $(ls $FILE)"
apt-get install -y $2
up
say "installed again $?, $(service delfim status)"
apt-get purge -y delfim
say "purged $?, $(dpkg -l delfim 2>/dev/null | tail -1 | cut -c1-2), etc $(ls -d /etc/delfim /etc/default/delfim /etc/init.d/delfim 2>/dev/null), group $(getent group delfim)"
say "logs $(find /log -name '*.bin*' -o -name 'state*' | wc -l), opt $(ls -d /opt/delfim 2>/dev/null)"
