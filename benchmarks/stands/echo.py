"""The bare transport: a process that returns what it receives, with the settings of a cell's state and queries.

`python -m benchmarks.stands.echo ENDPOINT` echoes publications on `bench/ping` to `bench/pong` and answers queries on
`bench/ask`.
"""

import signal
import sys

import zenoh

from wire.session import close_session, open_session

PING, PONG, ASK = "bench/ping", "bench/pong", "bench/ask"


def main(endpoint: str) -> None:
    session = open_session(listen=[endpoint])
    pong = session.declare_publisher(
        PONG, congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.REAL_TIME, express=True
    )

    def back(sample: zenoh.Sample) -> None:
        pong.put(sample.payload)

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(ASK, query.payload if query.payload is not None else b"", express=True)

    session.declare_subscriber(PING, back)
    session.declare_queryable(ASK, answer)
    print("ready", flush=True)
    signal.sigwait({signal.SIGTERM, signal.SIGINT})
    close_session(session)


if __name__ == "__main__":
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGINT})
    main(sys.argv[1])
