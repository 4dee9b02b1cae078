"""`delfim image`: shows the boat's image, installs one, confirms it. The slots are services/image/slots.py; this file finds out
whether the boat is under way.
"""

import argparse
import os
from pathlib import Path

from delfim import config
from delfim.base.errors import DelfimError, Refused
from delfim.commands import vehicle_file
from delfim.services.image import imagefile, slots
from delfim.services.tables import Image
from delfim.vehicle.operator.link import Link

ANSWER_S = 10.0  # for the answer of a vehicle on a busy board


def options(parser: argparse.ArgumentParser) -> None:
    vehicle_file(parser)
    parser.add_argument(
        "verb", choices=["status", "verify", "install", "confirm"], help="What to do; verify and install need an image."
    )
    parser.add_argument("image", metavar="IMAGE", nargs="?", help="The uploaded file that `make image` packed.")


def run(asked: argparse.Namespace) -> int:
    """Run the command. Returns the exit code; raises DelfimError for a failure that the user can put right."""
    settings = config.load(asked.file, asked.set)
    if (asked.verb in ("verify", "install")) != bool(asked.image):
        raise DelfimError(f"image {asked.verb}: {'takes no image file' if asked.image else 'name the image file'}")
    try:
        if asked.verb == "status":
            return status(settings)
        if asked.verb == "confirm":
            return confirm(settings)
        reason = under_way(settings)
        if reason:  # verify, too: it keeps disk and processor busy
            raise Refused(f"image {asked.verb} refused: {reason}")
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
