"""Timeouts of connections: a client that sends its request too slowly is cut off, as it would block others."""

import asyncio
from typing import ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

PATIENCE = 5.0
"""Timeout of the headers of a request [s]."""
OF_A_BODY = 20.0
"""Timeout of the body, from its headers on [s]."""
MOST_WAITING = 256
"""Largest number of connections with an incomplete request; beyond it the oldest is closed."""


class Connection(H11Protocol):
    """HTTP/1.1 connection with a timeout for each request."""

    _waiting: ClassVar[dict["Connection", None]] = {}
    """Connections with an incomplete request, the oldest first."""
    _deadline: asyncio.TimerHandle | None = None
    _of_a_body = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._wait(PATIENCE)

    def data_received(self, data: bytes) -> None:
        """See `asyncio.Protocol`."""
        if self._deadline is None:  # the next request of a connection that is kept
            self._wait(PATIENCE)
        super().data_received(data)
        if self.conn.their_state is h11.SEND_BODY:
            if not self._of_a_body:
                self._wait(OF_A_BODY)
                self._of_a_body = True
        elif self.conn.their_state is not h11.IDLE:
            self._no_longer()

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._no_longer()
        super().connection_lost(exc)

    def _wait(self, seconds: float) -> None:
        self._no_longer()
        if len(self._waiting) >= MOST_WAITING:
            next(iter(self._waiting))._give_up()
        self._waiting[self] = None
        self._deadline = self.loop.call_later(seconds, self._give_up)

    def _no_longer(self) -> None:
        self._waiting.pop(self, None)
        self._of_a_body = False
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self) -> None:
        self._no_longer()
        self.transport.abort()
