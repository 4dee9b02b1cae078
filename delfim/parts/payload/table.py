"""The keys of payload programs in a vehicle's file (docs/payloads.md)."""

from typing import Annotated

import msgspec

from delfim.base.ranges import Name, PayloadRight, ShownName
from delfim.base.tables import Table


class PayloadTable(Table, frozen=True):
    """An outside program: started and supervised, given navigation, its values logged and shown (docs/payloads.md)."""

    command: Annotated[tuple[str, ...], msgspec.Meta(min_length=1, max_length=32)]  # absolute path, and words
    user: str = "nobody"  # system user that runs it, not root; where the suite itself is not run by root, that user
    memory_max_mb: Annotated[int, msgspec.Meta(ge=1, le=1 << 20)] = 128  # of all; without control groups, of each process
    cpu_max: Annotated[float, msgspec.Meta(gt=0.0, le=1024.0)] = 0.5  # processors, of what nobody else wants
    processes_max: Annotated[int, msgspec.Meta(ge=1, le=1000)] = 16  # processes and threads at once
    network: bool = False  # it may connect, also to the boat's doors on this computer; otherwise it has no network at all
    shown: Annotated[tuple[ShownName, ...], msgspec.Meta(max_length=8)] = ()  # numbers that it tells, for consoles to show
    may: tuple[PayloadRight, ...] = ()  # orders that the boat takes from it, in the mode of its name, below all others

    def __post_init__(self) -> None:
        if not self.command[0].startswith("/"):
            raise ValueError("command: the program's absolute path comes first, as /log/programs/sonar")
        if self.user == "root":
            raise ValueError("user: a payload does not run as root")
        if self.shown and "values" not in self.may:
            raise ValueError('shown: the program needs the right "values" to tell them')


Payloads = dict[Name, PayloadTable]
