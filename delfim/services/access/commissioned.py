"""The instructions for a person with the files that `delfim commission` made: what to carry where, and what to type ashore.

A command is told for each door that somebody ashore can open; tests/commands/test_opened_doors.py types them.
"""

from collections.abc import Collection, Iterator, Sequence
from ipaddress import IPv4Interface
from pathlib import Path
from shlex import quote
from typing import Final

from delfim import config
from delfim.base.ranges import address, is_loopback
from delfim.canproxy.tables import Cantcpd
from delfim.services.tables import Ftpd, GuestTable, Httpd, Slipd, Sshd, Tablet

BOAT: Final = "/log/.boat"  # aboard; names with a dot in front are given out by no service


def bus(settings: config.Vehicle) -> str:
    """The boat's first bus that is more than a loop within its computer, which somebody ashore may watch; "" for none."""
    return next((each for each in settings.buses if not each.startswith("canloop:")), "")


def carried(output: Path, settings: config.Vehicle, kind: str, network: IPv4Interface, interface: str) -> str:
    """The places where the files go; `kind` is what the boat's computer runs, image or debian. An image has no system to log in
    to. Where an older `.boat` is, its files are replaced: without -T the new ones would lie in a folder within it, unread."""
    made = quote(f"{output}/boat")
    if kind == "debian":
        login = f"USER@{network.ip}"
        lines = [
            "To the boat's computer by cable, with the package installed (docs/install.md); USER is yours there:",
            f"    scp -r {made} {login}:.boat",
            f"    ssh -t {login} 'sudo cp -rT .boat {BOAT} && sudo rm -r .boat && sudo chown -R root: {BOAT}'",
            f"    ssh -t {login} 'sudo sed -i s,^VEHICLE=.*,VEHICLE={BOAT}/boat.toml, /etc/default/delfim'",
            f"    ssh -t {login} 'sudo service delfim restart'",
        ]
    else:
        lines = [
            "To the boat's disk, by hand and never over the radio; /mnt is where its log partition is mounted (docs/image.md):",
            f"    sudo cp -rT {made} /mnt/.boat",
            "    sudo chown -R root: /mnt/.boat; sudo chmod 700 /mnt/.boat",
            "    words for its kernel (boot/grub/boat.cfg or cmdline.txt): "
            f"VEHICLE={BOAT}/boat.toml NET={interface} ADDRESS={network}",
        ]
    if settings.of(GuestTable).enabled:
        lines.append(f"To the guest computer: {output}/guest/guest.key (docs/guest.md)")
    return "\n".join(lines)


def ashore(output: Path, settings: config.Vehicle, own: str, crew: Sequence[str], running: Collection[str]) -> str:
    """The commands for the operator's computer, and what is left to do. `own`: the boat's address where it has no radio."""
    shore = output / "shore"
    commands = "\n".join(f"    {line}" for line in _commands(shore, settings, own, crew[0], running))
    return f"""To the operator's computer: {shore}, where you type
{commands}
Each user has a key (unless they had one) and a password of their own there: {", ".join(crew)}. Give each their files, boat.crt
and known_hosts.

Before it goes into the water: delfim check --sea {quote(f"{output}/boat/boat.toml")}, and docs/sea.md."""


def _commands(shore: Path, settings: config.Vehicle, own: str, user: str, running: Collection[str]) -> Iterator[str]:
    """The commands, one for each listener that is open beyond the boat's computer."""
    from delfim.canproxy.cantcp.access import bus_name

    line, mavlink = settings.of(Slipd), settings.table("mavlink")
    boat = line.address if line.device else own
    if line.device:
        yield from _shore(line)
    if not is_loopback(mavlink.listen):
        key, file = quote(f"{shore}/mavlink.key"), quote(f"{shore}/boat.toml")
        yield f"delfim console --boats 0.0.0.0:14550 --key {key} --vehicle {file}"
    if "sshd" in running and not is_loopback(listen := settings.of(Sshd).listen):
        key = f"-i {quote(f'{shore}/{user}.key')} " if (shore / f"{user}.key").exists() else ""
        known = quote(f"UserKnownHostsFile={_word(shore / 'known_hosts')}")
        yield f"ssh {_port('-p', listen, 22)}{key}-o {known} {user}@{boat}"
    if "ftpd" in running and not is_loopback(listen := settings.of(Ftpd).listen):
        tls = f"set ftp:ssl-force true; set ssl:ca-file {_word(shore / 'boat.crt')}"
        yield f"lftp {_port('-p', listen, 21)}-u {user} -e {quote(tls)} {boat}"
    watched = bus(settings)
    if "cantcpd" in running and watched and not is_loopback(listen := settings.of(Cantcpd).listen[0]):
        yield f"delfim can dump socketcand:{boat}:{address(listen)[1]}:{bus_name(watched)}"
    if "httpd" in running and not is_loopback(listen := settings.of(Httpd).listen):
        port = address(listen)[1]
        yield f"browser: http://{boat}{'' if port == 80 else f':{port}'}/"
    if "tabletd" in running and not is_loopback(listen := settings.of(Tablet).listen):
        yield f"tablet: https://{boat}:{address(listen)[1]}/ with the token of {shore}/tablet.token (docs/tablet.md)"


def _word(path: Path) -> str:
    """A path as one word of ssh's and of lftp's own language, within the shell's."""
    return f'"{path}"' if " " in str(path) else str(path)


def _port(option: str, listen: str, usual: int) -> str:
    port = address(listen)[1]
    return "" if port == usual else f"{option} {port} "


def _shore(line: Slipd) -> Iterator[str]:
    """The command for the radio's other end."""
    boat, ashore = (f"{line.address}={line.station}", f"{line.peer}/24") if line.station else (line.address, line.peer)
    yield f"sudo delfim shore /dev/ttyUSB0 --boats {boat} --address {ashore} \\"
    yield f"    --baud {line.baud} --radio-bps {line.radio_bps} --encapsulation {line.encapsulation} --mtu {line.mtu}"
