"""The names of topics, nodes and messages in rmw_zenoh, ROS 2 over Zenoh (docs/design.md of ros2/rmw_zenoh).

A topic's key is `<domain>/<topic>/<type>/<type hash>`. A node and each of its publishers and subscriptions is a liveliness
token that says what it is; tools such as `ros2 topic list` see those. Beside a message are its number, its time and its sender.
"""

import hashlib
import struct
from typing import Final, Literal, NamedTuple

QOS: Final = "::,10:,:,:,,"  # the profile by default: reliable, volatile, the last ten; empty fields are those of rmw_zenoh
_ATTACHMENT: Final = struct.Struct("<qqB16s")


class RosType(NamedTuple):
    """A message's type, as sensor_msgs/msg/NavSatFix, and its hash (REP 2016)."""

    name: str
    hash: str

    @property
    def dds(self) -> str:
        package, kind, name = self.name.split("/")
        return f"{package}::{kind}::dds_::{name}_"


class RosNode(NamedTuple):
    """The node of this process: `session` is Zenoh's id, `name` is in `namespace`, as /otter."""

    domain: int
    session: str
    namespace: str
    name: str

    def token(self) -> str:
        return f"@ros2_lv/{self.domain}/{self.session}/0/0/NN/%/{_mangled(self.namespace)}/{self.name}"

    def key(self, topic: str, of: RosType) -> str:
        return f"{self.domain}/{topic.strip('/')}/{of.dds}/{of.hash}"

    def endpoint(self, number: int, kind: Literal["MP", "MS"], topic: str, of: RosType) -> str:
        """The token of a publisher or a subscription; numbers differ within the node."""
        place = f"@ros2_lv/{self.domain}/{self.session}/0/{number}/{kind}/%/{_mangled(self.namespace)}/{self.name}"
        return f"{place}/{_mangled(topic)}/{of.dds}/{of.hash}/{QOS}"


def attachment(number: int, utc_ns: int, token: str) -> bytes:
    """The attachment of a message: its number from 1 on, its time, and 16 bytes that name the publisher of this token."""
    return _ATTACHMENT.pack(number, utc_ns, 16, hashlib.sha256(token.encode()).digest()[:16])


def _mangled(name: str) -> str:
    return name.replace("/", "%")
