"""`delfim image`: shows the boat's image, installs one, tries it, confirms it; writes a Raspberry Pi's card. The slots are
services/image/slots.py, the card services/image/card.py; this file finds out whether the boat is under way.
"""

import argparse
import os
from pathlib import Path

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.commands import vehicle_file
from delfim.services.image import imagefile, raspberry, slots
from delfim.services.supervision import shutdown
from delfim.services.tables import Image
from delfim.vehicle.operator.link import Link

VERBS = ("status", "verify", "install", "try", "confirm", "write")
LOG = "/log"  # where the image mounts the log partition
ANSWER_S = 10.0  # for the answer of a vehicle on a busy board


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument("verb", choices=VERBS, help="What to do; verify, install and write need an image.")
    parser.add_argument("image", metavar="IMAGE", nargs="?", help="The uploaded file that `make image` packed.")
    card = parser.add_argument_group("write: a Raspberry Pi's card, with the boat's files beside FILE (docs/raspberry.md)")
    card.add_argument("--card", metavar="DEVICE", help="The card, /dev/sdX, or a file of its size. All of it is overwritten.")
    card.add_argument(
        "--boot", metavar="FOLDER", help="The first partition of Raspberry Pi OS (64 bit): the board's boot files."
    )
    card.add_argument("--board", choices=raspberry.BOARDS, help="The board.")
    card.add_argument("--hat", choices=[each for each in raspberry.HATS if each], default="", help="Its CAN hat.")
    card.add_argument(
        "--clock", choices=[each for each in raspberry.CLOCKS if each], default="", help="Its battery clock on I2C."
    )
    card.add_argument("--interface", default="eth0", help="The boat's own network (%(default)s).")
    card.add_argument("--network", default="192.168.2.10/24", help="The boat's address there (%(default)s).")


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns the exit code; raises DelfimError for a failure that the user can put right."""
    settings = config.load(asked.file, asked.set)
    if (asked.verb in ("verify", "install", "write")) != bool(asked.image):
        raise DelfimError(f"image {asked.verb}: {'takes no image file' if asked.image else 'name the image file'}")
    try:
        if asked.verb == "write":
            return write(settings, asked)
        if asked.verb == "status":
            return status(settings)
        if asked.verb == "confirm":
            return confirm(settings)
        reason = under_way(settings)
        if reason:  # verify, too: it keeps disk and processor busy
            raise Refused(f"image {asked.verb} refused: {reason}")
        if asked.verb == "try":
            return begin(settings)
        os.nice(19)
        return install(settings, Path(asked.image)) if asked.verb == "install" else verify(settings, Path(asked.image))
    except OSError as error:
        raise DelfimError(f"image {asked.verb}: {error.filename or 'boot partition'}: {error.strerror}") from None


def under_way(settings: config.Vehicle) -> str:
    """The reason why no image may be installed now; "" if the boat rests. A vehicle that is not running moves nothing."""
    try:
        link = Link(settings.console.socket, ANSWER_S)
    except DelfimError:
        return ""
    with link:
        try:
            state = link.ask("state")
        except DelfimError as error:
            return f"cannot find out whether the boat is under way: {error}"
    if state["mode"] != "idle":
        return f"the boat is under way, in mode {state['mode']}"
    return "a propeller turns" if any(each["thrust"] for each in state["thrusters"].values()) else ""


def verify(settings: config.Vehicle, bundle: Path) -> int:
    image = imagefile.verify(bundle, settings.of(Image).signers)
    print(f"{bundle.name}: version {image.manifest.version}, whole, signed by {image.signer}")
    return 0


def install(settings: config.Vehicle, bundle: Path) -> int:
    imagefile.verify(bundle, settings.of(Image).signers)  # before anything on the partition is touched
    with slots.boot_partition(settings.of(Image), write=True) as both:
        slot, image = both.install(bundle, settings.of(Image).signers)
    print(f"version {image.manifest.version}, signed by {image.signer}, is in slot {slot} and is tried at the next start.")
    print("If it works, confirm it then, or the next start is the old one: delfim image FILE confirm")
    return 0


def begin(settings: config.Vehicle) -> int:
    """Restart a Raspberry Pi into its trial. Raises Refused, OSError where no supervisor would restart it."""
    place = settings.runtime.run_directory
    if not shutdown.is_listening(shutdown.socket_path(place)):
        raise Refused("no supervisor of the boat runs here, and nobody would restart the computer")
    with slots.boot_partition(settings.of(Image), write=True) as both:
        words = both.begin_trial()
    shutdown.words_path(place).write_text(words)
    shutdown.request(shutdown.socket_path(place), "reboot", "an image is tried")
    print("The computer restarts into the new image. Confirm it then, or the start after that is the old one.")
    return 0


def write(settings: config.Vehicle, asked: argparse.Namespace) -> int:
    """Write a Raspberry Pi's card. Raises DelfimError, OSError."""
    from delfim.services.image import card

    if not (asked.card and asked.boot and asked.board):
        raise DelfimError("image write: --card, --boot and --board say what is written where")
    table, file = settings.of(Image), Path(asked.file)
    partitions = tuple(f"{raspberry.CARD}{number}" for number in raspberry.PARTITIONS.values())
    if (table.partition, table.slots) != (f"{raspberry.CARD}1", partitions):
        text = f'partition = "{raspberry.CARD}1", slots = {list(partitions)}'
        raise Refused(f"{file}: it could not be updated later: [image] must say {text}")
    words = f"VEHICLE={LOG}/{card.BOAT}/{file.name} NET={asked.interface} ADDRESS={asked.network}"
    fitted = card.Fitted(raspberry.BOARDS[asked.board], raspberry.HATS[asked.hat], raspberry.CLOCKS[asked.clock], words)
    said = card.write_card(Path(asked.card), Path(asked.image), table.signers, Path(asked.boot), file.parent, fitted)
    print(f"{asked.card}: {fitted.board.title}, {fitted.hat.title}, {fitted.clock.title}; {', '.join(said)}; read back")
    print(f"The boat's files are on its log partition as {card.BOAT}: this card is as secret as they are.")
    return 0


def confirm(settings: config.Vehicle) -> int:
    running, _ = slots.started(Path("/proc/cmdline").read_text())
    with slots.boot_partition(settings.of(Image), write=True) as both:
        both.confirm(running)
    slots.confirmed(settings.runtime.run_directory)
    print(f"slot {running} is confirmed: it is started from now on")
    return 0


def status(settings: config.Vehicle) -> int:
    """Print the slots. Returns 1 if a slot that may be started is damaged or an image was rolled back."""
    running, tried = slots.started(Path("/proc/cmdline").read_text())
    with slots.boot_partition(settings.of(Image), write=False) as both:
        environment = both.environment()
        damages = {slot: both.damage(slot) for slot in slots.SLOTS}
        manifests = {slot: None if damages[slot] else both.manifest(slot) for slot in slots.SLOTS}
    for slot, manifest in manifests.items():
        words = [f"version {manifest.version}" if manifest else damages[slot]]
        words += ["confirmed"] if slot == environment.slot else []
        words += ["tried at the next start"] if slot == environment.trial else []
        words += ["running"] if slot == running else []
        print(f"slot {slot}: {', '.join(words)}")
    said = slots.present_notice(settings.runtime.run_directory)
    print(said or ("started from no slot" if not running else "nothing to confirm"))
    return int(bool(damages[environment.slot]) or bool(said and tried != running))
