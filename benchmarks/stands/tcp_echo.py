"""The bare transport of RTDE: returns what it receives on one TCP connection.

`python -m benchmarks.stands.tcp_echo PORT`
"""

import socket
import sys

from benchmarks.harness.processes import READY


def main(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)) as listening:
        print(READY, flush=True)
        client, _ = listening.accept()
        with client:
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while data := client.recv(4096):
                client.sendall(data)


if __name__ == "__main__":
    main(int(sys.argv[1]))
