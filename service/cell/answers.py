"""Sends a control plane's answers on a thread of its own: a client that does not read them never blocks the loop."""

import queue
import threading

import structlog
import zenoh

from service.messages import Message

CAPACITY = 1024
"""Largest number of answers that wait to be sent; further ones are dropped, except those to stops."""

_log = structlog.get_logger("service.control_plane")


class Answers:
    """Sends answers in their order.

    Zenoh blocks a reply to a peer that does not read, until it closes the link to that peer
    (`wire.session.UNREAD_S`).
    """

    def __init__(self) -> None:
        self._waiting: queue.SimpleQueue[tuple[zenoh.Query, str, Message]] = queue.SimpleQueue()
        threading.Thread(target=self._work, name="answers", daemon=True).start()

    def send(self, asked: zenoh.Query, key: str, message: Message, *, always: bool = False) -> None:
        """Have an answer sent. It neither blocks nor raises, on any thread.

        Args:
            asked: the query, which ends with its answer.
            key: under which it was served.
            message: the answer.
            always: do not drop it, however many wait.
        """
        if always or self._waiting.qsize() < CAPACITY:
            self._waiting.put((asked, key, message))

    def _work(self) -> None:
        while True:
            asked, key, message = self._waiting.get()
            try:
                with asked:
                    asked.reply(key, message.model_dump_json().encode(), express=True)
            except Exception as error:  # the answers to others must go on
                _log.warning("reply", key=key, error=str(error))
            del asked  # a query that is kept has no end at its client
