"""The keys of cameras in a vehicle's file (docs/camera.md)."""

import re
from typing import Annotated

import msgspec

from delfim.base.ranges import Megabytes, Name
from delfim.base.tables import Table, text

PORTS = 14600  # and the boat's number: where its cameras are asked
LIVE_PORTS = 14900  # and twice the boat's number, and the next: where they are shown by WebRTC
STREAMS = 2  # of them at once
Side = Annotated[int, msgspec.Meta(ge=64, le=3840)]
PictureOrigin = Annotated[str, text("(test|rtsps?://[^ ]+|/dev/[^ ]+)", '"rtsp://HOST/...", "/dev/video0", or "test"')]


class CameraTable(Table, frozen=True):
    """A camera: its pictures go to the console with what the link leaves, and are kept aboard (docs/camera.md)."""

    source: PictureOrigin  # where the pictures come from; "test" is played
    credentials: str = ""  # of an RTSP camera: file with USER:PASSWORD in one line, mode 0600; "": it asks for none
    width_px: Side = 640  # of its largest pictures, an even number
    height_px: Side = 360  # of them
    rate_hz: Annotated[float, msgspec.Meta(ge=0.2, le=30.0)] = 10.0  # pictures, where the link carries so many
    webrtc: bool = False  # where the link is good, also as a film by WebRTC; it needs `delfim[webrtc]` aboard
    kept_mb: Megabytes = 1000  # of pictures aboard, one a second; the oldest give way; 0: none

    def __post_init__(self) -> None:
        if re.match(r"rtsps?://[^/]*@", self.source):
            raise ValueError("source: a password has no place in this file: name a file with USER:PASSWORD as credentials")
        if self.credentials and not self.source.startswith("rtsp"):
            raise ValueError("credentials: only an rtsp source asks for any")
        if self.width_px % 8 or self.height_px % 8:
            raise ValueError("width_px and height_px: multiples of 8, as 640 and 360")


Cameras = dict[Name, CameraTable]
