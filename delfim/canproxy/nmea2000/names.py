"""The devices of an NMEA 2000 bus and their addresses: an address may be given to another device, a NAME stays with its own."""

from collections.abc import Iterable
from typing import Any, Final

from delfim.base.selection import Newest
from delfim.canproxy.nmea2000.parcels import CLAIM, EVERYBODY
from delfim.canproxy.nmea2000.pgns import ADDRESS_MAX

CLAIMED: Final = CLAIM | EVERYBODY  # the PGN of a claim as its frame has it: claims are for everybody


class Names:
    """The NAME of each address, learned from claims. `preferred` of the vehicle's file: addresses, and NAMEs of 16 hexadecimal
    digits, best first. `own_name`: of this boat's own device, which is no source for it; -1: it has none."""

    def __init__(self, preferred: tuple[int | str, ...], own_name: int = -1) -> None:
        self._wanted = tuple(each if isinstance(each, int) else int(each, 16) for each in preferred)
        self._own_name = own_name
        self.own = -1  # address of the boat's own device; -1: not known
        self.by_address: dict[int, int] = {}
        self.preferred = self._addresses()  # where they are known

    def learn(self, address: int, data: bytes, kinds: Iterable[Newest[int, Any]]) -> bool:
        """Learn from a frame in which a device claims an address, or gives it up (254). Values in `kinds` from an address that
        is another device's now are dropped. False: the frame is no claim."""
        if len(data) != 8:
            return False
        name = int.from_bytes(data, "little")
        if self.by_address.get(address) == name:
            return True
        void = [held for held, known in self.by_address.items() if known == name or held == address]
        for held in void:
            del self.by_address[held]
        if address <= ADDRESS_MAX:
            self.by_address[address] = name
        self.own = next((held for held, known in self.by_address.items() if known == self._own_name), -1)
        before, self.preferred = self.preferred, self._addresses()
        for newest in kinds:
            for held in void:
                newest.put(held, None, 0.0)
            if self.preferred != before:  # otherwise the present address stays chosen
                newest.prefer(self.preferred)
        return True

    def _addresses(self) -> tuple[int, ...]:
        of_name = {name: address for address, name in self.by_address.items()}
        found = (each if each <= ADDRESS_MAX else of_name.get(each) for each in self._wanted)
        return tuple(each for each in found if each is not None)
