# Written by client-py/generate from _async/client.py; change that.
"""Client: the front door."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from types import TracebackType

import grpc

from .._access import FilePath, accesses
from .._convert import detectors as convert_detectors
from .._convert import sensors as convert
from .._options import Options, headers
from ..types.detectors import DetectorInfo, DetectorLayout, ImageInput
from ..types.sensors import ClockOffset
from .bound import Bound
from .evaluation import Evaluation
from .operations import Operations
from .session import Session, Sessions
from .toolbox import Toolbox
from .transport import Link, Transport


class Client(Bound):
    """A percept server.

        with Client("127.0.0.1:50051") as client:
            session = client.sessions.create("robot-7", sensors=[SensorSpec("laser", kind="lidar2d")])

    May be shared by threads. Failures are `PerceptError`s.
    """

    def __init__(
        self,
        address: str | Sequence[str] = "127.0.0.1:50051",
        *,
        timeout_s: float = 30.0,
        retries: int = 5,
        metadata: Mapping[str, str | bytes] | None = None,
        token: str | None = None,
        token_file: FilePath | None = None,
        allow_insecure_token: bool = False,
        tls: bool | None = None,
        ca_file: FilePath | None = None,
        cert_file: FilePath | None = None,
        key_file: FilePath | None = None,
        server_name: str | None = None,
        credentials: grpc.ChannelCredentials | None = None,
    ) -> None:
        """`address` is host:port, or https://host:port (grpcs:// is the same) for TLS, which `tls=True` and
        any of the files turn on, too: `ca_file` whom to trust instead of the well-known authorities,
        `cert_file` with `key_file` (PEM) who asks, `server_name` what the server's certificate is made out
        to if not to the address. `credentials` are gRPC's own, in place of the files. Several addresses name
        servers on one store: when one is away the next is asked, and a session is followed to the server that
        has it.

        `token` (or `token_file`, read again whenever it changes) goes along with every call; over a link
        without TLS to another machine only with `allow_insecure_token`.

        `timeout_s` bounds every call, tries included; calls that can be repeated without harm are tried again
        up to `retries` times while the server is away or asks to come back later; `metadata` are headers of
        every call. `with_options` changes these three for some calls."""
        reached = accesses(
            address,
            token=token,
            token_file=token_file,
            allow_insecure_token=allow_insecure_token,
            tls=tls,
            ca_file=ca_file,
            cert_file=cert_file,
            key_file=key_file,
            credentials=credentials,
        )
        options = Options(timeout_s=timeout_s, retries=retries, metadata=headers(metadata))
        super().__init__(Transport(Link(reached, server_name), options))

    def __repr__(self) -> str:
        return f"Client({self._transport.link.access.target!r})"

    @property
    def sessions(self) -> Sessions:
        """The sessions of the server."""
        return Sessions(self._transport)

    @property
    def toolbox(self) -> Toolbox:
        """Perception without a session."""
        return Toolbox(self._transport)

    @property
    def evaluation(self) -> Evaluation:
        """Metrics against ground truth."""
        return Evaluation(self._transport)

    @property
    def operations(self) -> Operations:
        """Work of one's own that goes on at the server."""
        return Operations(self._transport)

    def session(self, session_id: str) -> Session:
        """A session by its name, without asking whether it exists."""
        return Session(self._transport, session_id)

    def upload_detector(
        self,
        model: str | os.PathLike[str] | bytes,
        *,
        name: str,
        layout: DetectorLayout | str,
        labels: Sequence[str] | str,
        score_threshold: float | None = None,
        iou_threshold: float | None = None,
        image_input: ImageInput | None = None,
    ) -> DetectorInfo:
        """Stores an ONNX model, of a file or bytes, for everybody of this tenant; sessions use it by
        `params={"detection": {"learned": name}}`.

        labels: the model's classes in its order; a word is one class. Thresholds are 0.5 (score)
        and 0.45 (overlap) by default, the input as models of the layout usually have it. What is
        broken or too large is refused with the reason; the same model again is no error."""
        return self._transport.call(
            convert_detectors.upload_detector(
                model, name, layout, labels, score_threshold, iou_threshold, image_input
            )
        )

    def detectors(self) -> tuple[DetectorInfo, ...]:
        """The learned detectors that may be used, by name: the server's and this tenant's."""
        return self._transport.call(convert_detectors.list_detectors())

    def delete_detector(self, name: str) -> None:
        """Removes a detector that was uploaded; refused while a session names it."""
        self._transport.call(convert_detectors.delete_detector(name))

    def health(self) -> bool:
        """Whether the server says that it serves, within 2 s or the client's time-out if that is shorter;
        False if it cannot be reached."""
        return self._transport.serving()

    def sync_time(self) -> ClockOffset:
        """The server's clock against this machine's; the quickest of five measurements."""
        offsets = [self._transport.call(convert.sync_time()) for _ in range(5)]
        return min(offsets, key=lambda o: o.round_trip_ns)

    def close(self) -> None:
        """Ends all calls and streams, also those of `with_options`, which share the link."""
        self._transport.link.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
