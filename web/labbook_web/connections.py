"""Timeouts of connections: a client that sends its request too slowly is cut off, as it would block others."""

import asyncio
from typing import ClassVar

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

HEADER_TIMEOUT = 5.0
"""Timeout of the headers of a request [s]."""
BODY_TIMEOUT = 20.0
"""Timeout of the body, from its headers on [s]."""
PENDING_LIMIT = 256
"""Largest number of connections with an incomplete request; beyond it the oldest is closed."""


class Connection(H11Protocol):
    """HTTP/1.1 connection with a timeout for each request."""

    _pending: ClassVar[dict["Connection", None]] = {}
    """Connections with an incomplete request, the oldest first."""
    _deadline: asyncio.TimerHandle | None = None
    _in_body = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """See `asyncio.Protocol`."""
        super().connection_made(transport)
        self._start_timer(HEADER_TIMEOUT)

    def data_received(self, data: bytes) -> None:
        """See `asyncio.Protocol`."""
        if self._deadline is None:  # the next request of a connection that is kept
            self._start_timer(HEADER_TIMEOUT)
        super().data_received(data)
        if self.conn.their_state is h11.SEND_BODY:
            if not self._in_body:
                self._start_timer(BODY_TIMEOUT)
                self._in_body = True
        elif self.conn.their_state is not h11.IDLE:
            self._stop_timer()

    def connection_lost(self, exc: Exception | None) -> None:
        """See `asyncio.Protocol`."""
        self._stop_timer()
        super().connection_lost(exc)

    def _start_timer(self, seconds: float) -> None:
        self._stop_timer()
        if len(self._pending) >= PENDING_LIMIT:
            next(iter(self._pending))._abort()
        self._pending[self] = None
        self._deadline = self.loop.call_later(seconds, self._abort)

    def _stop_timer(self) -> None:
        self._pending.pop(self, None)
        self._in_body = False
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _abort(self) -> None:
        self._stop_timer()
        self.transport.abort()
