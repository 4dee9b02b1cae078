"""Cells of S-57 made for tests: the records of ISO 8211 that GDAL needs, about a harbour that nobody has built."""

import struct
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final, Self

Place = tuple[float, float]
"""Latitude and longitude, degrees."""
UNIT: Final = b"\x1f"
END: Final = b"\x1e"
FIELDS: Final = {  # tag: controls, name, labels, formats (S-57 part 3, clause 7)
    "0001": ("0500;&   ", "record", "", "(b12)"),
    "DSID": (
        "1600;&   ",
        "data set",
        "RCNM!RCID!EXPP!INTU!DSNM!EDTN!UPDN!UADT!ISDT!STED!PRSP!PSDN!PRED!PROF!AGEN!COMT",
        "(b11,b14,2b11,3A,2A(8),R(4),b11,2A,b11,b12,A)",
    ),
    "DSSI": ("1600;&   ", "structure", "DSTR!AALL!NALL!NOMR!NOCR!NOGR!NOLR!NOIN!NOCN!NOED!NOFA", "(3b11,8b14)"),
    "DSPM": (
        "1600;&   ",
        "parameters",
        "RCNM!RCID!HDAT!VDAT!SDAT!CSCL!DUNI!HUNI!PUNI!COUN!COMF!SOMF!COMT",
        "(b11,b14,3b11,b14,4b11,2b14,A)",
    ),
    "FRID": ("1600;&   ", "feature", "RCNM!RCID!PRIM!GRUP!OBJL!RVER!RUIN", "(b11,b14,2b11,2b12,b11)"),
    "FOID": ("1600;&   ", "feature's name", "AGEN!FIDN!FIDS", "(b12,b14,b12)"),
    "ATTF": ("2600;&-A ", "attributes", "*ATTL!ATVL", "(b12,A)"),
    "FSPT": ("2600;&   ", "feature's shape", "*NAME!ORNT!USAG!MASK", "(B(40),3b11)"),
    "VRID": ("1600;&   ", "vector", "RCNM!RCID!RVER!RUIN", "(b11,b14,b12,b11)"),
    "VRPT": ("2600;&   ", "vector's nodes", "*NAME!ORNT!USAG!TOPI!MASK", "(B(40),4b11)"),
    "SG2D": ("2500;&   ", "places", "*YCOO!XCOO", "(2b24)"),
    "SG3D": ("2500;&   ", "soundings", "*YCOO!XCOO!VE3D", "(3b24)"),
}
CLASSES: Final = {
    "BRIDGE": 11,
    "DEPARE": 42,
    "LNDARE": 71,
    "OBSTRN": 86,
    "RESARE": 112,
    "SOUNDG": 129,
    "UWTROC": 153,
    "WRECKS": 159,
    "M_COVR": 302,
    "M_QUAL": 308,
}
KEYS: Final = {"CATCOV": 18, "CATZOC": 72, "DRVAL1": 87, "DRVAL2": 88, "OBJNAM": 116, "QUASOU": 125, "RESTRN": 131}
KEYS_MORE: Final = {"VALSOU": 179, "VERCLR": 181, "WATLEV": 187}
META: Final = ("M_COVR", "M_QUAL")
ISOLATED, CONNECTED, EDGE = 110, 120, 130


def record(fields: Iterable[tuple[str, bytes]], leader: bytes = b" D     ", more: bytes = b"   ") -> bytes:
    """One record of ISO 8211."""
    directory, body = b"", b""
    for tag, data in fields:
        directory += b"%s%05d%05d" % (tag.encode(), len(data), len(body))
        body += data
    base = 24 + len(directory) + 1
    return b"%05d%s%05d%s5504" % (base + len(body), leader, base, more) + directory + END + body


def described() -> bytes:
    """The first record, which describes the fields."""
    names = [tag for tag in FIELDS if tag != "0001"]
    tree = "".join(f"0001{tag}" if tag in ("DSID", "DSPM", "FRID", "VRID") else _parent(tag) + tag for tag in names)
    rows = [("0000", b"0000;&   " + UNIT + tree.encode() + END)]
    for tag, (controls, name, labels, formats) in FIELDS.items():
        rows.append((tag, controls.encode() + UNIT.join(each.encode() for each in (name, labels, formats)) + END))
    return record(rows, b"3LE1 09", b" ! ")


def _parent(tag: str) -> str:
    return {"DSSI": "DSID", "SG2D": "VRID", "SG3D": "VRID", "VRPT": "VRID"}.get(tag, "FRID")


class MadeCell:
    """A cell, or an update of one, record by record."""

    def __init__(self, name: str = "XX5TEST1", scale: int = 10_000, edition: int = 2, update: int = 0, first: int = 1) -> None:
        self.name, self._scale, self._edition, self._update = name, scale, edition, update
        self._rows, self._first = list[tuple[str, list[tuple[str, bytes]]]](), first
        self._names = dict.fromkeys((ISOLATED, CONNECTED, EDGE, 100), first - 1)

    def _vector(self, kind: int, *more: tuple[str, bytes]) -> bytes:
        self._names[kind] += 1
        name = struct.pack("<BI", kind, self._names[kind])
        self._rows.append((str(kind), [("VRID", name + struct.pack("<HB", 1, 1) + END), *more]))
        return name

    def _places(self, places: Iterable[Place]) -> bytes:
        return (
            b"".join(struct.pack("<ii", round(latitude * 1e7), round(longitude * 1e7)) for latitude, longitude in places) + END
        )

    def _edge(self, begin: bytes, end: bytes, between: Sequence[Place]) -> bytes:
        nodes = begin + b"\xff\xff\x01\xff" + end + b"\xff\xff\x02\xff" + END
        return self._vector(EDGE, ("VRPT", nodes), *([("SG2D", self._places(between))] if between else []))

    def _node(self, place: Place, kind: int) -> bytes:
        return self._vector(kind, ("SG2D", self._places([place])))

    def _feature(self, layer: str, kind: int, shape: bytes, values: dict[str, object]) -> Self:
        self._names[100] += 1
        number, keys = self._names[100], KEYS | KEYS_MORE
        told = b"".join(struct.pack("<H", keys[key]) + str(value).encode() + UNIT for key, value in values.items())
        head = struct.pack("<BIBBHHB", 100, number, kind, 1 if layer in ("DEPARE", "LNDARE") else 2, CLASSES[layer], 1, 1)
        fields = [("FRID", head + END), ("FOID", struct.pack("<HIH", 550, number, 1) + END)]
        fields += [("ATTF", told + END)] if told else []
        self._rows.append(("meta" if layer in META else "geo", [*fields, ("FSPT", shape + END)]))
        return self

    def area(self, layer: str, *rings: Sequence[Place], **values: object) -> Self:
        """An area; the rings behind the first are holes in it."""
        shape = b""
        for number, ring in enumerate(rings):
            nodes = [self._node(ring[0], CONNECTED), self._node(ring[2], CONNECTED)]
            edges = self._edge(nodes[0], nodes[1], ring[1:2]), self._edge(nodes[1], nodes[0], ring[3:])
            shape += b"".join(edge + bytes((1, 2 if number else 1, 255)) for edge in edges)
        return self._feature(layer, 3, shape, values)

    def point(self, layer: str, place: Place, **values: object) -> Self:
        return self._feature(layer, 1, self._node(place, ISOLATED) + b"\xff\xff\xff", values)

    def line(self, layer: str, begin: Place, end: Place, **values: object) -> Self:
        edge = self._edge(self._node(begin, CONNECTED), self._node(end, CONNECTED), [])
        return self._feature(layer, 2, edge + b"\x01\xff\xff", values)

    def soundings(self, *places: tuple[float, float, float]) -> Self:
        data = b"".join(struct.pack("<iii", round(n * 1e7), round(e * 1e7), round(depth_m * 10)) for n, e, depth_m in places)
        name = self._vector(ISOLATED, ("SG3D", data + END))
        return self._feature("SOUNDG", 1, name + b"\xff\xff\xff", {})

    def data(self) -> bytes:
        counts = [sum(kind == each for kind, _ in self._rows) for each in ("meta", "geo", "110", "120", "130")]
        texts = UNIT.join(each.encode() for each in (f"{self.name}.000", str(self._edition), str(self._update))) + UNIT
        head = struct.pack("<BIBB", 10, 1, 2 if self._update else 1, 5) + texts + b"20260101" * 2 + b"03.1"
        head += struct.pack("<B", 1) + UNIT + b"2.0" + UNIT + struct.pack("<BH", 1, 550) + UNIT + END
        meta, geo, isolated, connected, edges = counts
        structure = struct.pack("<3B8I", 2, 1, 1, meta, 0, geo, 0, isolated, connected, edges, 0) + END
        scale = struct.pack("<BI3BI4BII", 20, 1, 2, 17, 23, self._scale, 1, 1, 1, 1, 10_000_000, 10) + UNIT + END
        rows = [[("DSID", head), ("DSSI", structure)], *([] if self._update else [[("DSPM", scale)]])]
        rows += [row for kind, row in self._rows if kind.isdigit()] + [row for kind, row in self._rows if not kind.isdigit()]
        numbered = ([("0001", struct.pack("<H", number) + END), *row] for number, row in enumerate(rows, 1))
        return described() + b"".join(map(record, numbered))

    def write(self, folder: Path) -> Path:
        file = folder / f"{self.name}.{self._update:03}"
        file.write_bytes(self.data())
        return file


def square(north: float, east: float, half: float, half_east: float | None = None) -> list[Place]:
    wide = half if half_east is None else half_east
    return [(north - half, east - wide), (north - half, east + wide), (north + half, east + wide), (north + half, east - wide)]


def harbour(zone: int = 2) -> MadeCell:
    """Water of 5 to 10 m about 38.69 N, 9.21 W, with a bank, an island, a rock and a bridge. `zone`: of confidence."""
    sea, bank, land = square(38.69, -9.21, 0.03), square(38.695, -9.205, 0.001), square(38.687, -9.213, 0.0008)
    cell = MadeCell()
    cell.area("DEPARE", sea, bank[::-1], land[::-1], DRVAL1=5, DRVAL2=10)
    cell.area("DEPARE", bank, DRVAL1=0, DRVAL2=2).area("LNDARE", land, OBJNAM="Ilha")
    cell.point("UWTROC", (38.691, -9.216), WATLEV=5, VALSOU=0.3).point("WRECKS", (38.684, -9.204), QUASOU=2, WATLEV=3)
    cell.point("OBSTRN", (38.683, -9.218), VALSOU=4.2, QUASOU=1, WATLEV=3)
    cell.line("BRIDGE", (38.698, -9.220), (38.698, -9.216), VERCLR=2.5)
    cell.area("RESARE", square(38.700, -9.200, 0.001), RESTRN="7", OBJNAM="Cais")
    cell.soundings((38.6945, -9.2045, 0.6), (38.6905, -9.2105, 6.2))
    return cell.area("M_COVR", sea, CATCOV=1).area("M_QUAL", sea, CATZOC=zone)


def catalogue(*files: Path) -> bytes:
    """The catalogue of an exchange set with these files."""
    rows = []
    for number, file in enumerate(files, 1):
        texts = [f"CD{number:010}{file.name}", "", "V01X01", "BIN", "", "", "", f"{zlib.crc32(file.read_bytes()):08X}", ""]
        rows.append(record([("0001", b"%05d" % number + END), ("CATD", UNIT.join(each.encode() for each in texts) + END)]))
    return record([("0000", b"0000;&   " + UNIT + b"0001CATD" + END)], b"3LE1 09", b" ! ") + b"".join(rows)
