"""Programs that talk to a peer on the loopback; the peer answers between ticks, so nothing depends on timing."""

import contextlib
import socket

import pytest

from sim_backend.ur_controller import events
from sim_backend.ur_controller.sockets import LARGEST_BUFFER, MOST_SOCKETS

HOST = "127.0.0.21"


class Peer:
    """A listening host and the connection that a program has made to it."""

    def __init__(self, bench):
        self.bench = bench
        self.listening = socket.create_server((HOST, 0))
        self.port = self.listening.getsockname()[1]
        self.connection = None

    def accept(self):
        self.listening.settimeout(5)
        self.connection, _ = self.listening.accept()
        self.connection.settimeout(5)
        return self.connection

    def talk(self, body, *replies):
        """Run a program that opens the connection first, then say what is to be said."""
        self.bench.program(f'opened = socket_open("{HOST}", {self.port}, "peer")\n{body}')
        self.bench.run(3)
        connection = self.accept()
        for reply in replies:
            connection.sendall(reply)
            self.bench.run(3)
        return connection

    def close(self):
        self.listening.close()
        if self.connection:
            self.connection.close()


@pytest.fixture
def peer(bench):
    peer = Peer(bench)
    yield peer
    bench.controller.close()
    peer.close()


def kept(bench, count):
    return [bench.get(f"output_int_register_{i}") for i in range(count)]


def store(expression, count):
    return f"v = {expression}\n" + "\n".join(f"write_output_integer_register({i}, v[{i}])" for i in range(count))


def received(connection, count):
    data = b""
    while len(data) < count:
        data += connection.recv(count - len(data))
    return data


def test_what_a_program_sends_arrives_as_bytes(bench, peer):
    body = (
        'socket_send_int(-2, "peer")\nsocket_send_byte(255, "peer")\nsocket_send_string("ab", "peer")\n'
        'socket_send_line("c", "peer")\nsocket_set_var("X", 5, "peer")\n'
        "write_output_boolean_register(0, opened)\nsleep(10)"
    )
    connection = peer.talk(body)
    bench.run(2)
    assert received(connection, 17) == b"\xff\xff\xff\xfe\xffabc\nSET X 5\n"
    assert bench.get("output_bit_registers0_to_31") == 1


def test_integers_are_read_however_they_are_cut(bench, peer):
    peer.talk(store('socket_read_binary_integer(2, "peer", 0)', 3), b"\x00\x00", b"\x00\x07\xff\xff", b"\xff\xfe")
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert kept(bench, 3) == [2, 7, -2]


def test_reads_that_find_what_they_need_take_no_time(bench, peer):
    body = "\n".join(
        f'v = socket_read_binary_integer(1, "peer", 2)\nwrite_output_integer_register({i}, v[1])' for i in range(3)
    )
    connection = peer.talk(f"sleep(0.1)\n{body}")
    connection.sendall(b"".join(i.to_bytes(4, "big") for i in (5, 6, 7)))
    bench.run(50)
    assert kept(bench, 3) == [5, 6, 7]


def test_a_read_gives_up_after_its_time_in_ticks(bench, peer):
    peer.talk(store('socket_read_binary_integer(1, "peer", 0.1)', 1) + "\nset_digital_out(0, True)\nsleep(10)")
    bench.run(40)
    assert bench.get("actual_digital_output_bits") == 0
    bench.run(20)
    assert bench.get("actual_digital_output_bits") == 1
    assert kept(bench, 1) == [0]


@pytest.mark.parametrize(
    ("call", "sent", "values"),
    [
        ('socket_read_byte_list(3, "peer")', b"\x01\x02\xff", [3, 1, 2, 255]),
        ('socket_read_ascii_float(2, "peer")', b"(1.0, -4)", [2, 1, -4]),
        ('socket_read_ascii_float(2, "peer")', b"(1.0, x)", [0, 0, 0]),
        ('socket_read_ascii_float(2, "peer")', b"(1.0)", [0, 0, 0]),
    ],
)
def test_lists_come_with_their_count_first(bench, peer, call, sent, values):
    peer.talk(store(call, len(values)), sent)
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert kept(bench, len(values)) == values


@pytest.mark.parametrize(
    ("call", "sent", "text"),
    [
        ('socket_read_line("peer")', b"hello\r\nmore", "hello"),
        ('socket_read_string("peer")', b"anything", "anything"),
        ('socket_read_string("peer", prefix="<", suffix=">")', b"no<yes>no", "yes"),
        ('socket_read_string("peer", suffix="\\n", interpret_escape=True)', b"line\nrest", "line"),
    ],
)
def test_texts_end_where_they_are_said_to_end(bench, peer, call, sent, text):
    peer.talk(f"textmsg({call})", sent)
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.of(events.Text)[0].text == text


def test_a_variable_is_asked_for_and_read(bench, peer):
    connection = peer.talk('write_output_float_register(0, socket_get_var("POS", "peer"))')
    assert received(connection, 8) == b"GET POS\n"
    connection.sendall(b"POS 42\n")
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert bench.get("output_double_register_0") == 42.0


def test_what_a_peer_sent_before_it_left_can_still_be_read(bench, peer):
    connection = peer.talk(
        "sleep(0.1)\n"
        + store('socket_read_binary_integer(1, "peer", 0)', 2)
        + "\n"
        + 'write_output_boolean_register(0, socket_send_int(1, "peer"))\n'
        + 'v = socket_read_byte_list(1, "peer", 0)\nwrite_output_integer_register(2, v[0])'
    )
    connection.sendall(b"\x00\x00\x00\x09")
    connection.close()
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert kept(bench, 2) == [1, 9]
    assert bench.get("output_int_register_2") == 0


@pytest.mark.parametrize("address", [f'"{HOST}", 1', '"no.such.host.invalid", 80', f'"{HOST}", 70000'])
def test_where_nobody_listens_opening_says_so_and_the_tick_goes_on(bench, address):
    bench.finish(f'write_output_boolean_register(0, not socket_open({address}, "peer"))')
    assert bench.get("output_bit_registers0_to_31") == 1


def test_a_name_that_was_never_opened_gives_nothing(bench):
    bench.finish(
        'write_output_boolean_register(0, socket_send_int(1, "none"))\nsocket_close("none")\n'
        'textmsg(socket_read_line("none"))'
    )
    assert bench.get("output_bit_registers0_to_31") == 0
    assert bench.of(events.Text)[0].text == ""


def test_connections_end_with_their_program(bench, peer):
    connection = peer.talk("sleep(0.02)")
    bench.until(lambda: bench.of(events.ProgramStopped))
    assert connection.recv(1) == b""


def test_connections_of_one_program_are_bounded(bench, peer):
    opens = "\n".join(f'ok = socket_open("{HOST}", {peer.port}, "s{i}")' for i in range(MOST_SOCKETS))
    bench.finish(
        f'{opens}\nwrite_output_boolean_register(0, ok)\nok = socket_open("{HOST}", {peer.port}, "over")\n'
        "write_output_boolean_register(1, ok)"
    )
    assert bench.get("output_bit_registers0_to_31") == 0b01


def test_a_peer_that_floods_fills_no_memory(bench, peer):
    connection = peer.talk('v = socket_read_string("peer", suffix="never", timeout=0)')
    connection.setblocking(False)
    sent = 0
    for _ in range(400):
        with contextlib.suppress(BlockingIOError):
            sent += connection.send(b"x" * 65536)
        bench.run(1)
    assert sent > LARGEST_BUFFER
    assert len(bench.controller.sockets.get("peer").buffer) <= LARGEST_BUFFER


def test_a_count_that_no_read_takes_ends_the_program(bench):
    bench.program('socket_read_binary_integer(31, "peer")')
    bench.run(2)
    assert bench.of(events.RuntimeFailed)
