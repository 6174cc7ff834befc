# Written by client-py/generate from _async/recordings.py; change that.
"""Recordings: begin, end, list and remove them."""

from __future__ import annotations

from .._convert import recordings as convert
from ..types.recordings import Recording, StoredRecording
from .bound import SessionBound
from .pages import Pages


class Recordings(SessionBound):
    """The recordings of a session: what it is sent and its poses, as MCAP files in the server's folder. How
    the newest stands is in the session's info, too. All of it raises FailedPrecondition (RECORDING_OFF) where
    the server has no such folder."""

    def start(self) -> Recording:
        """Records the session from its next frame on; one that is recorded goes on as it is. It goes on in
        another recording after the session slept, and ends for good when the server restarts. Raises
        FailedPrecondition (SESSION_NOT_MAPPING) in the mode INGEST_ONLY."""
        return self._transport.call(convert.start(self.session_id))

    def stop(self) -> Recording | None:
        """Ends what is recorded, until start() or the server's restart, and tells how it ended; also again,
        if it had. None if no frame came. Raises FailedPrecondition (NOT_RECORDED) if the session was not
        recorded since the server began."""
        return self._transport.call(convert.stop(self.session_id))

    def list(self, *, page_size: int = 0) -> Pages[StoredRecording]:
        """What the server has recorded of the session, the oldest first. Pages are asked for as they are
        used."""
        return self._transport.pages(convert.list_recordings(self.session_id, page_size))

    def delete(self, recording_id: str) -> None:
        """Removes a recording that has ended, for good. Raises NotFound (RECORDING_NOT_FOUND), or
        FailedPrecondition (RECORDING_UNDER_WAY) while it is written."""
        self._transport.call(convert.delete(self.session_id, recording_id))
