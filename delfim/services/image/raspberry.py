"""Raspberry Pi: what the boards, CAN hats and clocks of their owners need of its boot files, by name, in one table.

The board's own boot loader reads autoboot.txt on the card's first partition: which partition it starts, and which one once
after a restart with the word `tryboot` (Raspberry Pi documentation, config.txt/autoboot.txt). The file is one sector: it is
written over itself, so that no power cut leaves half of it.
"""

from typing import Final, NamedTuple

from delfim.base.errors import FormatError

AUTOBOOT: Final = "autoboot.txt"
SECTOR_BYTES: Final = 512  # of a card, and all that the boot loader reads of this file
PARTITIONS: Final = {"a": 2, "b": 3}  # of the slots; 1 has autoboot.txt, 4 is the log partition
LOG_PARTITION: Final = 4
CARD: Final = "/dev/mmcblk0p"
TRY: Final = "0 tryboot"  # of reboot(2): partition 0 is the default one
_HEAD: Final = "# delfim"


class PiBoard(NamedTuple):
    """A board. `files` of the boot loader must be there, `config` is for it alone, `modules` are loaded by /init."""

    title: str
    filter: str  # of config.txt
    files: tuple[str, ...]
    config: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()


class Fitting(NamedTuple):
    """A hat or a clock: its lines of config.txt, and the modules."""

    title: str
    config: tuple[str, ...]
    modules: tuple[str, ...]


_OLD: Final = ("bootcode.bin", "start.elf", "fixup.dat")
_USB: Final = "dtoverlay=dwc2,dr_mode=host"
_SPI: Final = "dtparam=spi=on"
_I2C: Final = "dtparam=i2c_arm=on"  # on the pins 3 and 5, and i2c-dev makes it /dev/i2c-1: sensors, PCA9685
_CARD: Final = ("fixed", "gpio-regulator", "sdhci-iproc", "bcm2835")
BOARDS: Final = {
    "pi3": PiBoard(
        "Raspberry Pi 3B, 3B+",
        "pi3",
        (*_OLD, "bcm2710-rpi-3-b.dtb"),
        (_USB,),
        (*_CARD, "spi-bcm2835", "dwc2", "smsc95xx", "smsc", "lan78xx", "microchip", "i2c-bcm2835", "bcm2835_wdt"),
    ),
    "zero2": PiBoard(
        "Raspberry Pi Zero 2 W",
        "pi02",
        (*_OLD, "bcm2710-rpi-zero-2-w.dtb"),
        (_USB,),
        (*_CARD, "spi-bcm2835", "dwc2", "i2c-bcm2835", "bcm2835_wdt"),
    ),
    "pi4": PiBoard(
        "Raspberry Pi 4B, 400",
        "pi4",
        ("start4.elf", "fixup4.dat", "bcm2711-rpi-4-b.dtb"),
        (),
        (*_CARD, "spi-bcm2835", "mdio-bcm-unimac", "broadcom", "genet", "i2c-bcm2835", "bcm2835_wdt"),
    ),
    "pi5": PiBoard(  # its boot loader is in the board; the UART of the pins is not the console's until it is asked for
        "Raspberry Pi 5",
        "pi5",
        ("bcm2712-rpi-5-b.dtb",),
        ("dtparam=uart0_console",),
        ("rp1", "spi-dw-mmio", "macb", "broadcom", "i2c-designware-platform", "bcm2835_wdt"),
    ),
}
HATS: Final = {  # oscillator and interrupt as their makers' pages have them
    "": Fitting("no hat", (), ()),
    "waveshare-rs485-can": Fitting(
        "Waveshare RS485 CAN HAT (MCP2515, crystal of 12 MHz)",
        (_SPI, "dtoverlay=mcp2515-can0,oscillator=12000000,interrupt=25,spimaxfrequency=2000000"),
        ("mcp251x",),
    ),
    "waveshare-rs485-can-b": Fitting(
        "Waveshare RS485 CAN HAT (B) (MCP2515, crystal of 16 MHz)",
        (_SPI, "dtoverlay=mcp2515-can0,oscillator=16000000,interrupt=25,spimaxfrequency=1000000"),
        ("mcp251x",),
    ),
    "waveshare-2ch-can": Fitting(
        "Waveshare 2-CH CAN HAT (two MCP2515)",
        (
            _SPI,
            "dtoverlay=mcp2515-can1,oscillator=16000000,interrupt=25",
            "dtoverlay=mcp2515-can0,oscillator=16000000,interrupt=23",
        ),
        ("mcp251x",),
    ),
    "waveshare-2ch-can-fd": Fitting(
        "Waveshare 2-CH CAN FD HAT (two MCP2518FD, on two SPI)",
        (_SPI, "dtoverlay=spi1-3cs", "dtoverlay=mcp251xfd,spi0-0,interrupt=25", "dtoverlay=mcp251xfd,spi1-0,interrupt=24"),
        ("mcp251xfd",),
    ),
    "pican2": Fitting(
        "PiCAN2 (MCP2515, crystal of 16 MHz)",
        (_SPI, "dtoverlay=mcp2515-can0,oscillator=16000000,interrupt=25"),
        ("mcp251x",),
    ),
    "seeed-can-fd-v1": Fitting("Seeed 2-channel CAN FD (MCP2517FD)", ("dtoverlay=seeed-can-fd-hat-v1",), ("mcp251xfd",)),
    "seeed-can-fd-v2": Fitting(
        "Seeed 2-channel CAN FD with a clock (MCP2518FD, PCF85063)",
        ("dtoverlay=seeed-can-fd-hat-v2",),
        ("mcp251xfd", "rtc-pcf85063"),
    ),
}
CLOCKS: Final = {
    "": Fitting("no clock", (), ()),
    "ds1307": Fitting("DS1307", ("dtoverlay=i2c-rtc,ds1307",), ("rtc-ds1307",)),
    "ds3231": Fitting("DS3231", ("dtoverlay=i2c-rtc,ds3231",), ("rtc-ds1307",)),
    "pcf8523": Fitting("PCF8523", ("dtoverlay=i2c-rtc,pcf8523",), ("rtc-pcf8523",)),
    "pcf85063a": Fitting("PCF85063A", ("dtoverlay=i2c-rtc,pcf85063a",), ("rtc-pcf85063",)),
}


def config_txt(hat: Fitting, clock: Fitting) -> str:
    """The boot loader's settings, the same in both slots and for all boards: each takes its own part."""
    lines = ["[all]", "arm_64bit=1", "kernel=vmlinuz", "initramfs initramfs.gz followkernel", "enable_uart=1", _I2C]
    lines += [*hat.config, *clock.config]
    for board in BOARDS.values():
        lines += [f"[{board.filter}]", *board.config] if board.config else []
    return "\n".join([*lines, "[all]", ""])


def cmdline_txt(slot: str, board: PiBoard, hat: Fitting, clock: Fitting, words: str) -> str:
    """The kernel's command line in a slot; `words` are the boat's own for /init."""
    modules = ",".join(dict.fromkeys((*board.modules, "vfat", "i2c-dev", *hat.modules, "can-raw", *clock.modules)))
    own = f"LOG={CARD}{LOG_PARTITION} SLOTS={CARD}1 MODULES={modules} delfim.slot={slot}"
    return f"console=serial0,115200 quiet panic=10 {own} {words}".strip() + "\n"


def autoboot_txt(slot: str, trial: str, tried: str) -> bytes:
    """One sector: the slot that is started, the other one for a trial, and the words of slots.Environment."""
    other = PARTITIONS["b" if slot == "a" else "a"]
    text = f"{_HEAD} slot={slot} trial={trial} tried={tried}\n[all]\ntryboot_a_b=1\nboot_partition={PARTITIONS[slot]}\n"
    return (text + f"[tryboot]\nboot_partition={other}\n").encode().ljust(SECTOR_BYTES - 1) + b"\n"


def parse_autoboot(text: bytes) -> tuple[str, str, str]:
    """Slot, trial and tried. Raises FormatError."""
    words = dict.fromkeys(("slot", "trial", "tried"), "")
    head = text.split(b"\n")[0].decode("ascii", "replace").split(" ")
    words |= dict(word.split("=", 1) for word in head if "=" in word)
    found = words["slot"], words["trial"], words["tried"]
    if text[:SECTOR_BYTES] != (autoboot_txt(*found) if found[0] in PARTITIONS else b"") or len(text) != SECTOR_BYTES:
        raise FormatError(f"{AUTOBOOT} is damaged, or not by this program")
    return found


def lacking(names: set[str], board: PiBoard, hat: Fitting, clock: Fitting) -> list[str]:
    """What a folder with these files (relative to it) lacks to start this board with hat and clock."""
    lines = (*board.config, *hat.config, *clock.config)
    overlays = [line.removeprefix("dtoverlay=").split(",")[0] for line in lines if line.startswith("dtoverlay=")]
    return [name for name in (*board.files, *(f"overlays/{each}.dtbo" for each in overlays)) if name not in names]
