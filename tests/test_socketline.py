"""Lines that are sockets. Those with two wires are tried where they are used: tests/services, tests/vehicle."""

import select
import socket
from pathlib import Path

from delfim.base.clock import ManualClock
from delfim.lines.serialline import SerialLine


def readable(line: SerialLine) -> bytes:
    assert select.select([line], [], [], 60.0)[0]
    return line.read()


def test_tcp_in_the_place_of_a_line_comes_back_and_never_waits() -> None:
    heard = list[bytes]()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        line = SerialLine(f"tcp:127.0.0.1:{port}", 0, ManualClock(), lambda _, data: heard.append(data))
        end, _ = server.accept()
        assert line.read() == b""
        assert line.write(b"$PYDIR,1,2\r\n")
        assert end.recv(100) == b"$PYDIR,1,2\r\n"
        end.sendall(b"answer")
        assert readable(line) == b"answer"
        assert heard == [b"answer"]
        end.close()
        assert readable(line) == b""
        assert (line.trouble, line.write(b"lost")) == ("hung up", False)
        assert line.rebind()
        end, _ = server.accept()
        with end:
            assert line.write(b"again")
            assert end.recv(100) == b"again"
            while line.put(b"x" * 65536):  # the other end does not read
                pass
            assert not line.write(b"one more")
            assert line.trouble == ""
    line.close()


def test_nobody_listens_at_the_socket_yet() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    line = SerialLine(f"tcp:127.0.0.1:{port}", 0, ManualClock())
    assert not line.write(b"x")
    assert line.trouble == "Connection refused"
    line.close()


def test_records_of_a_local_socket_stay_whole_and_a_full_queue_is_told(tmp_path: Path) -> None:
    place = tmp_path / "outlet"
    line = SerialLine(f"unix:{place}", 0, ManualClock())
    assert (line.trouble, line.write(b"x")) == ("No such file or directory", False)
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as server:
        server.bind(str(place))
        server.listen(1)
        assert line.rebind()
        end, _ = server.accept()
        with end:
            assert line.write(b"one")
            assert line.write(b"two")
            assert [end.recv(100), end.recv(100)] == [b"one", b"two"]
            while line.write(b"x" * 1000):
                pass
            assert line.trouble == ""
        assert readable(line) == b""
        assert line.trouble
    line.close()
