"""Clients that read the status of a cell over HTTP: `python -m benchmarks.stands.status_readers PORT SECONDS`.

Each has a connection of its own and asks at `RATE_HZ`. At the end they print the durations of their requests, s, as one
line of JSON.
"""

import asyncio
import json
import random
import sys
import time

CLIENTS = 50
RATE_HZ = 10.0


async def _ask(port: int, until_s: float, spans: list[float]) -> None:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    request = f"GET /status HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode()
    due_s = time.perf_counter() + random.random() / RATE_HZ  # noqa: S311  # not secret
    while due_s < until_s:
        await asyncio.sleep(max(0.0, due_s - time.perf_counter()))
        begun_s = time.perf_counter()
        writer.write(request)
        head = (await reader.readuntil(b"\r\n\r\n")).lower()
        await reader.readexactly(int(head.partition(b"content-length:")[2].partition(b"\r\n")[0]))
        spans.append(time.perf_counter() - begun_s)
        due_s += 1.0 / RATE_HZ
    writer.close()


async def main(port: int, seconds: float) -> None:
    print("ready", flush=True)
    spans: list[float] = []
    until_s = time.perf_counter() + seconds
    await asyncio.gather(*(_ask(port, until_s, spans) for _ in range(CLIENTS)))
    print(json.dumps(spans), flush=True)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2])))
