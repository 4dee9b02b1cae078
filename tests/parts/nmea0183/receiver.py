"""What a u-blox receiver sends, made by pyubx2, which knows the format by itself."""

from typing import Any

from pyubx2 import GET, UBXMessage

WELL = {"validDate": 1, "validTime": 1, "fullyResolved": 1, "gnssFixOk": 1, "fixType": 3}
MOVING = {"gnssFixOK": 1, "relPosValid": 1, "isMoving": 1, "relPosHeadingValid": 1, "carrSoln": 2}


def message(name: str, **values: Any) -> bytes:
    data: bytes = UBXMessage("NAV", name, GET, **values).serialize()
    return data


def pvt(second: float = 5.0, **values: Any) -> bytes:
    """NAV-PVT of 2026-11-22, 12:00 and so many seconds: an RTK fix off Lisbon that makes 1 m/s to the north."""
    whole = int(second)
    at = {"year": 2026, "month": 11, "day": 22, "hour": 12, "min": whole // 60, "second": whole % 60}
    at |= {"iTOW": round(43200_000 + second * 1000), "nano": round((second - whole) * 1e9)}
    here = {"lat": 38.69, "lon": -9.2, "velN": 1000, "velE": 0, "hAcc": 14, "sAcc": 50, "numSV": 20}
    return message("NAV-PVT", **(at | here | WELL | {"carrSoln": 2, "lastCorrectionAge": 2} | values))


def relposned(heading_deg: float = 90.0, length_cm: int = 150, **values: Any) -> bytes:
    """NAV-RELPOSNED of a rover whose base is aboard."""
    told = {"version": 1, "relPosHeading": heading_deg, "relPosLength": length_cm, "accHeading": 0.4}
    return message("NAV-RELPOSNED", **(told | MOVING | values))


def dop(hdop: float = 0.9) -> bytes:
    return message("NAV-DOP", hDOP=hdop)
