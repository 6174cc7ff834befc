"""What all that makes calls has in common."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TypeVar

from ..errors import WrongType
from .transport import AsyncTransport

B = TypeVar("B", bound="AsyncBound")


class AsyncBound:
    """Something of a server's that is asked over a transport."""

    def __init__(self, transport: AsyncTransport) -> None:
        self._transport = transport

    def with_options(
        self: B,
        *,
        timeout_s: float | None = None,
        retries: int | None = None,
        metadata: Mapping[str, str | bytes] | None = None,
    ) -> B:
        """The same over the same link, with other options for the calls that are made from it: their
        time-out (tries included), how often those that may be repeated are tried again, further headers."""
        other = copy.copy(self)
        other._transport = self._transport.with_options(timeout_s, retries, metadata)
        return other


class AsyncSessionBound(AsyncBound):
    """Something of a session's."""

    def __init__(self, transport: AsyncTransport, session_id: str) -> None:
        super().__init__(transport)
        if not isinstance(session_id, str):
            message = f"session_id is {session_id!r}; give its id, e.g. 'robot-7'"
            raise WrongType(message, reason="ID_INVALID", field="session_id")
        #: Name of the session.
        self.session_id = session_id
