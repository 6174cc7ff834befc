"""A link between two that can be cut, as wireless ones are."""

from __future__ import annotations

import contextlib
import socket
import threading

from support.server import free_port


class Link:
    """Forwards what connects to `endpoint` to another; each is tcp/host:port."""

    def __init__(self, to: str) -> None:
        host, port = to.removeprefix("tcp/").rsplit(":", 1)
        self._to = (host, int(port))
        here = free_port()
        self.endpoint = f"tcp/127.0.0.1:{here}"
        self._listener = socket.create_server(("127.0.0.1", here))
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Breaks the connections there are; new ones may come at once."""
        broken, self._open = self._open, []
        for each in broken:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._listener.close()
        self.cut()

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._listener.accept()
                try:
                    far = socket.create_connection(self._to)
                except OSError:
                    near.close()
                    continue
                self._open += [near, far]
                for a, b in ((near, far), (far, near)):
                    threading.Thread(target=self._forward, args=(a, b), daemon=True).start()

    @staticmethod
    def _forward(a: socket.socket, b: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := a.recv(1 << 16):
                b.sendall(data)
        for each in (a, b):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
