"""What the program says of vehicle files: the page of all keys, and how wrong files are refused."""

import contextlib
import hashlib
import io
import re
import tempfile
from pathlib import Path
from typing import Final

from delfim.__main__ import main
from delfim.console.terminal.describe import describe
from tests.oracles.keeping import Lines

DESCRIBED: Final = "delfim describe"
BOAT: Final = '[boat]\nname = "x"\n'
THRUSTER: Final = '[[thrusters]]\nname = "{}"\ndriver = "{}"\naddress = {}\ny_m = {}\nthrust_n = [-50.0, 50.0]\n'


def _two(driver: str, second: str = "port", address: int = 1) -> str:
    return THRUSTER.format("starboard", driver, 0, 0.5) + THRUSTER.format(second, driver, address, -0.5)


WRONG: Final = {
    "empty": "",
    "no TOML": "[boat\nname = 1",
    "no text": "\udcff\udcfe",
    "no name": "[boat]\nid = 3\n",
    "a name with a space": '[boat]\nname = "my boat"\n',
    "a number that is text": BOAT + 'id = "two"\n',
    "a number out of range": BOAT + "id = 250\n",
    "an unknown table": BOAT + "[navigatoin]\nrate_hz = 5.0\n",
    "an unknown key": BOAT + "[navigation]\nrate_hertz = 5.0\n",
    "three mistakes": '[boat]\nname = "my boat"\nid = 0\n[speed]\n',
    "an unknown source": BOAT + '[navigation]\nsources = ["loran"]\n',
    "no source": BOAT + "[navigation]\nsources = []\n",
    "a rate of zero": BOAT + "[navigation]\nrate_hz = 0.0\n",
    "a rate that is no number": BOAT + "[navigation]\nrate_hz = nan\n",
    "an unknown action": BOAT + '[failsafe.battery_low]\nplay = "explode"\n',
    "an action for an unknown mode": BOAT + '[failsafe.battery_low]\nsleep = "stop"\n',
    "a fence of two corners": BOAT + "[fence]\nkeep_in = [{polygon = [[38.0, -9.0], [38.1, -9.0]]}]\n",
    "a fence that crosses itself": BOAT
    + "[fence]\nkeep_in = [{polygon = [[38.0, -9.0], [38.1, -8.9], [38.1, -9.0], [38.0, -8.9]]}]\n",
    "a centre without a radius": BOAT + "[fence]\nkeep_out = [{centre = [[38.0, -9.0]]}]\n",
    "an unknown driver": BOAT + THRUSTER.format("main", "steam", 0, 0.0),
    "two thrusters of one name": BOAT + _two("dsor", "starboard"),
    "two thrusters with one address": BOAT + _two("pwm", address=0),
    "a thruster beyond its driver's addresses": BOAT + _two("heron", address=2),
    "a command by rpm without its most": BOAT + _two("vesc"),
    "two protocols on one bus": BOAT + _two("dronecan") + '[dronecan]\ninterface = "can0"\n[can]\ninterface = "can0"\n',
    "an unknown service": BOAT + "[services.teapot]\nenabled = true\n",
    "a place that is none": BOAT + '[services.httpd]\nplace = "ashore"\n',
    "an address without a port": BOAT + '[httpd]\nlisten = "127.0.0.1"\n',
    "an unknown kind of water": BOAT + "[simulation.sea]\nwaves_m = 3.0\n",
    "wind beyond its range": BOAT + "[simulation.sea]\nwind_mps = 1e9\n",
    "a sensor that nobody knows": BOAT + '[sensors]\nnames = ["sonar"]\n',
    "a hand-set of an unknown protocol": BOAT + '[handset]\ndevice = "/dev/receiver"\nprotocol = "morse"\n',
}


def files() -> Lines:
    """The page by its tables, and each wrong file: exit code, and what is said."""
    return {DESCRIBED: _described(), **{f"wrong file: {name}": _checked(text) for name, text in WRONG.items()}}


def _described() -> list[str]:
    """A digest of each table; docs/vehicle-file.md has the text."""
    head, *parts = re.split(r"^## ", describe(), flags=re.MULTILINE)
    titled = [("the head", head), *((part.partition("\n")[0], part) for part in parts)]
    return [f"{title} {hashlib.blake2b(text.encode(), digest_size=6).hexdigest()}" for title, text in titled]


def explained(then: str, now: str, kept: Lines, here: Lines, name: str) -> str:
    """Of the page of keys there are digests alone."""
    title = then.rpartition(" ")[0]
    same = name == DESCRIBED and title == now.rpartition(" ")[0]
    return f"{title} is not described as it was: git diff docs/vehicle-file.md" if same else ""


def _checked(text: str) -> list[str]:
    with tempfile.TemporaryDirectory() as place:
        file, said = Path(place) / "boat.toml", io.StringIO()
        file.write_bytes(text.encode(errors="surrogateescape"))
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code = main(["check", str(file)])
        words = re.sub("not TOML: .*", "not TOML", said.getvalue().replace(f"{place}/", ""))  # the rest is of the interpreter
    return [f"exit code {code}", *words.splitlines()]
