#!/bin/busybox sh
# PID 1 of a guest: gives it a root of its own, then runs the numbered command files of its folder, one after the other.
# The root is the host's, read through hostfs, with every change kept in memory (overlay): nothing of the host can be altered.
# Only this script's own folder is the host's for real; commands, their output and their exit codes pass through it.
# (Busybox, because a program with shared libraries costs 70 ms here. It needs /proc to find itself.)
folder=${0%/*}
modules=/usr/lib/uml/modules

/bin/busybox mount -t proc none /proc
if [ -z "$1" ]; then
    mount -t tmpfs none /mnt
    mkdir /mnt/changes /mnt/work /mnt/root
    insmod "$modules/$(uname -r)/kernel/fs/overlayfs/overlay.ko"
    mount -t overlay -o lowerdir=/,upperdir=/mnt/changes,workdir=/mnt/work none /mnt/root || exit
    mount -t hostfs -o "$folder" none "/mnt/root$folder"
    cd /mnt/root && pivot_root . mnt
    exec chroot . /bin/busybox sh "$0" inside
fi

umount -l /mnt
mount -t sysfs none /sys
mount -t devtmpfs none /dev
mkdir -p /dev/pts /dev/shm /lib/modules
mount -t devpts none /dev/pts
mount -t tmpfs none /dev/shm
mount -t tmpfs none /run
mount --bind "$modules" /lib/modules
echo 50 >/proc/sys/vm/dirty_writeback_centisecs # what a command prints reaches the host within a second
echo 50 >/proc/sys/vm/dirty_expire_centisecs
hostname guest
ip link set lo up
export PATH=/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin HOME=/root LANG=C.UTF-8
cd "$folder" || exit

commands() {
    exec </dev/tty0 >/dev/tty0
    stty -echo
    echo "GUEST ready"
    while read -r number timeout_s; do
        /usr/bin/timeout -k 2 "$timeout_s" /bin/sh -c '. ./profile; . "$FOLDER/$0.sh"' "$number" </dev/null >"$number.out" 2>&1
        echo $? >"$number.code"
        /bin/busybox grep workingset_refault_file /proc/vmstat >"$number.memory"
        echo "GUEST done $number"
    done
    poweroff -f
}

if [ "$MODE" = shell ]; then
    setsid -c /bin/bash --rcfile ./profile </dev/tty0 >/dev/tty0 2>&1
    poweroff -f
elif [ -n "$BOAT" ]; then # PID 1 is this script of a boat; the commands come from a process beside it
    printf '#!/bin/sh\n. %s/profile\nexec python -m delfim "$@"\n' "$folder" >/usr/local/bin/delfim
    chmod +x /usr/local/bin/delfim
    commands &
    exec /bin/sh "$BOAT"
fi
commands
