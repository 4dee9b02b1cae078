"""Who may come in, and who has to wait."""

import base64
import contextlib
import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from delfim.base.errors import FormatError
from delfim.services.access.connection_limits import ConnectionLimits, Patience, bulk, hashed, matches


def test_connections_are_counted_and_forgotten():
    a_door = ConnectionLimits(3, 2)
    assert [a_door.enter(address) for address in ("a", "a", "a", "b", "c")] == [True, True, False, True, False]
    assert a_door.refused == 2
    a_door.leave("a")
    assert a_door.enter("c")
    a_door.leave("b")
    assert dict(a_door.inside) == {"a": 1, "c": 1}


def test_each_wrong_word_doubles_the_pause_of_its_address():
    patience = Patience()
    pauses_s = []
    for _ in range(7):
        patience.failed("a", 100.0)
        pauses_s.append(patience.pause_s("a", 100.0))
    assert pauses_s == [1.0, 2.0, 4.0, 8.0, 16.0, 30.0, 30.0]
    assert patience.pause_s("a", 120.0) == 10.0
    assert patience.pause_s("a", 131.0) == 0.0
    assert patience.pause_s("b", 100.0) == 0.0
    patience.failed("a", 701.0)
    assert patience.pause_s("a", 701.0) == 1.0, "long ago is forgiven"
    patience.failed("a", 1301.0)
    assert patience.pause_s("a", 1301.0) == 2.0, "ten minutes are not long"
    assert patience.pause_s("a", 1301.5) == 1.5
    assert patience.failures == 9
    patience.failed("b", 0.0)
    assert [patience.pause_s("b", now_s) for now_s in (-700.0, 600.0)] == [701.0, 0.0]
    patience.succeeded("a")
    assert patience.pause_s("a", 800.0) == 0.0


def test_much_goes_behind_the_console_and_is_given_up_when_nobody_reads():
    with socket.create_server(("127.0.0.1", 0)) as server, socket.create_connection(server.getsockname()) as link:
        bulk(link, 60.0)
        assert link.getsockopt(socket.IPPROTO_IP, socket.IP_TOS) == 0x08, "IPTOS_THROUGHPUT"
        assert link.getsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT) == 60_000
        assert link.getsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT) == 32_768


def test_the_table_of_addresses_is_bounded():
    patience = Patience()
    for number in (*range(1000), 0, 1000):
        patience.failed(str(number), 0.0)
    assert [patience.pause_s(address, 0.0) for address in ("0", "1", "2", "1000")] == [2.0, 0.0, 1.0, 1.0]
    assert patience.failures == 1002


@pytest.mark.parametrize("password", ["sesame", "", "Água salgada", "\udcff", "x" * 1000])
def test_a_password_is_known_again_and_not_kept(password):
    kept = hashed(password)
    assert matches(password, kept)
    assert not matches(password + "x", kept)
    assert hashed(password) != kept, "another salt"
    assert not password or password not in kept


def test_the_hash_is_that_of_rfc_7914_with_the_stated_cost():
    assert hashed("sesame", b"salt") == "scrypt:c2FsdA==:TJ09H7NwAovKJhSUuMOBupk3YmySSmca8rBjedX5MbU="
    assert len(base64.b64decode(hashed("sesame").split(":")[1])) == 16


@pytest.mark.parametrize(
    "kept", ["md5:c2FsdA==:", "scrypt:c2FsdA==", "scrypt:c2Fs dA==:", "scrypt:c2FsdA==:x:y", "scrypt:c2F:"]
)
def test_a_hash_of_another_kind_is_refused(kept):
    with pytest.raises(FormatError, match="not a password from"):
        matches("x", kept)


@given(
    st.one_of(st.text(), st.text().map(lambda text: f"scrypt:{text}:{text}")).filter(
        lambda text: text.count(":") != 2 or "=" in text
    )
)
def test_what_is_no_hash_is_refused(kept):
    with contextlib.suppress(FormatError):
        assert not matches("x", kept)
