"""An identity provider on this machine: https, discovery, keys that change, tokens."""

from __future__ import annotations

import base64
import contextlib
import json
import pathlib
import ssl
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, utils

DISCOVERY, KEYS = "/.well-known/openid-configuration", "/keys"


def base64url(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


class Key:
    """A key of ES256 under a name."""

    def __init__(self, kid: str) -> None:
        self.kid, self._private = kid, ec.generate_private_key(ec.SECP256R1())

    def public(self) -> dict:
        """Its public half as a JWK."""
        numbers = self._private.public_key().public_numbers()
        x, y = (base64url(n.to_bytes(32, "big")) for n in (numbers.x, numbers.y))
        return {"kty": "EC", "crv": "P-256", "kid": self.kid, "use": "sig", "alg": "ES256", "x": x, "y": y}

    def sign(self, data: bytes) -> bytes:
        """RFC 7518, section 3.4: r and s side by side."""
        r, s = utils.decode_dss_signature(self._private.sign(data, ec.ECDSA(hashes.SHA256())))
        return r.to_bytes(32, "big") + s.to_bytes(32, "big")


class Provider:
    """Serves what `pages` has; may be stopped, and started again at the same address."""

    def __init__(self, files: tuple[pathlib.Path, pathlib.Path]) -> None:
        self._context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        self._context.load_cert_chain(*files)
        self._server: ThreadingHTTPServer | None = None
        self._port = 0
        #: Paths that were asked for.
        self.asked: list[str] = []
        self.start()
        self.keys = [Key("first")]
        self.pages = {DISCOVERY: self.described(), KEYS: self.key_set}

    @property
    def issuer(self) -> str:
        return f"https://127.0.0.1:{self._port}"

    def described(self, **other: str) -> dict:
        """The discovery document."""
        return {"issuer": self.issuer, "jwks_uri": self.issuer + KEYS, **other}

    def key_set(self) -> dict:
        """The JWKS."""
        return {"keys": [key.public() for key in self.keys]}

    def token(self, *, key: Key | None = None, header: dict | None = None, **claims: object) -> str:
        """A token that lets its holder write in all sessions of `default`, unless told otherwise."""
        key = key or self.keys[-1]
        head = {"alg": "ES256", "kid": key.kid, **(header or {})}
        said = {"iss": self.issuer, "aud": "percept", "sub": "robot-7", "exp": int(time.time()) + 600}
        said |= {"scope": "openid percept:write", "percept_tenant": "default", **claims}
        signed = ".".join(base64url(json.dumps(part).encode()) for part in (head, said))
        return f"{signed}.{base64url(key.sign(signed.encode()))}"

    def start(self) -> None:
        provider = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                provider.asked.append(self.path)
                page = provider.pages.get(self.path)
                body = json.dumps(page() if callable(page) else page).encode()
                self.send_response(200 if page is not None else 404)
                self.send_header("content-length", str(len(body)))
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                pass

        class Quiet(ThreadingHTTPServer):
            daemon_threads = True

            def handle_error(self, *_: object) -> None:
                """Who does not trust the certificate leaves in the handshake."""

        self._server = Quiet(("127.0.0.1", self._port), Handler)
        self._server.socket = self._context.wrap_socket(self._server.socket, server_side=True)
        self._port = self._server.server_port
        threading.Thread(target=self._server.serve_forever, args=(0.05,), daemon=True).start()

    def stop(self) -> None:
        if self._server is not None:
            self._server.shutdown()
            self._server.server_close()
            self._server = None

    def __enter__(self) -> Provider:
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):
            self.stop()
