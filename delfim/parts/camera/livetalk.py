"""What camerad and its program for WebRTC say to each other, a message in each packet of a SOCK_SEQPACKET pair."""

import msgspec


class StreamBegin(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """A page's offer, as a stream of this number."""

    stream: int
    camera: int
    payload: int
    certificate: bytes
    user: str
    password: str


class StreamRate(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """From now on; 0: no picture, but the connection stays."""

    stream: int
    bps: int


class StreamEnd(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """To the program: end it. From it: it has ended, and why."""

    stream: int
    why: str = ""


class StreamPicture(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """A picture of a camera."""

    camera: int
    taken_s: float  # by the monotonic clock, which both have
    taken_ms: int
    same_s: float  # since it was another one
    jpeg: bytes


class StreamAnswer(msgspec.Struct, frozen=True, tag=True, array_like=True):
    stream: int
    port: int
    ssrc: int
    certificate: bytes
    user: str
    password: str


class StreamSent(msgspec.Struct, frozen=True, tag=True, array_like=True):
    """Bytes of a stream until now, with all headers."""

    stream: int
    count: int


Order = StreamBegin | StreamRate | StreamEnd | StreamPicture
Report = StreamAnswer | StreamSent | StreamEnd
encode = msgspec.msgpack.Encoder().encode
read_order = msgspec.msgpack.Decoder(Order).decode
read_report = msgspec.msgpack.Decoder(Report).decode
