"""A flood of HTTP requests on loopback, bounded in time: `python -m benchmarks.stands.flood PORT SECONDS CONNECTIONS`.

It prints `ready` and, at the end, the number of answers it received.
"""

import asyncio
import sys
import time

PATHS = ("/status", "/runs", "/health")


async def _requests(port: int, until_s: float, offset: int) -> int:
    """Send one request after another on one connection; return the number of answers."""
    answers = 0
    while time.monotonic() < until_s:
        try:
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
        except OSError:
            await asyncio.sleep(0.05)
            continue
        try:
            while time.monotonic() < until_s:
                path = PATHS[(answers + offset) % len(PATHS)]
                writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
                await _read_answer(reader)
                answers += 1
        except (OSError, asyncio.IncompleteReadError):
            continue
        finally:
            writer.close()
    return answers


async def _read_answer(reader: asyncio.StreamReader) -> None:
    head = (await reader.readuntil(b"\r\n\r\n")).lower()
    length = head.partition(b"content-length:")[2].partition(b"\r\n")[0]
    await reader.readexactly(int(length or 0))


async def main(port: int, seconds: float, connections: int) -> None:
    until_s = time.monotonic() + seconds
    print("ready", flush=True)
    answers = await asyncio.gather(*(_requests(port, until_s, number) for number in range(connections)))
    print(f"{sum(answers)} answers, {sum(answers) / seconds:.0f} a second", flush=True)


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])))
