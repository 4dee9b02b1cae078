"""logd: writes the log messages of the bus's nodes to files (thesis 2.10)."""

import asyncio
import contextlib

from delfim.canproxy.dsor.messages import LOG_ID, Node
from delfim.canproxy.dsor.protocol import message_filter
from delfim.canproxy.dsor.receiver import Receiver
from delfim.canproxy.opening import open_bound
from delfim.canproxy.socket import CanAddress
from delfim.logging.nodelog import LogMessages
from delfim.services.runtime import Runtime
from delfim.services.tables import Logd


async def serve(runtime: Runtime) -> None:
    """Run the service until it is cancelled."""
    settings = runtime.config
    names = {node: Node(node).name.lower() if node in list(Node) else f"node-{node}" for node in settings.of(Logd).nodes}
    filters = tuple(CanAddress(*message_filter(source=node)) for node in names)
    with contextlib.ExitStack() as links:
        can = links.enter_context(open_bound(settings.can, settings.can.interface, filters))
        receiver = Receiver(settings.can.node, lambda message: message.id == LOG_ID and message.port is None)
        log = LogMessages(can, receiver, names, settings.log, runtime.clock)
        links.callback(log.close)
        links.enter_context(runtime.reading(can.fileno(), log.on_readable))
        links.enter_context(runtime.publishing("logd", log.report))
        while True:
            await asyncio.sleep(1.0)
            log.poll()
