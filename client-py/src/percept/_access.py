"""Where the server is, how the link to it is protected, and who asks: addresses, TLS files, tokens."""

from __future__ import annotations

import ipaddress
import os
import pathlib
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Union

import grpc

from .errors import InvalidArgument, WrongType

FilePath = Union[str, "os.PathLike[str]"]

DEFAULT_PORT = 50051
#: Forms of an address that say whether the link is protected.
_SCHEMES = {"https": True, "grpcs": True, "http": False, "grpc": False}
#: Forms that are gRPC's own.
_GRPC_FORMS = ("unix:", "unix-abstract:", "vsock:", "dns:", "ipv4:", "ipv6:", "xds:", "google-c2p:")
_HOST_PORT = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[0-9A-Za-z._-]+):[0-9]+")


@dataclass(frozen=True, kw_only=True)
class Access:
    """What a channel is opened with, and what its calls carry."""

    target: str
    #: None: the link is not protected.
    credentials: grpc.ChannelCredentials | None
    token: Token | None
    #: Whether the token may travel readably beyond this machine.
    allow_insecure_token: bool

    def at(self, server: str) -> Access | None:
        """The same at the address that a server told of another; None if that is no address to go to, or the
        token would travel readably."""
        try:
            target, by_scheme = _target(server)
        except InvalidArgument:
            return None
        if server.startswith(_GRPC_FORMS) or not _HOST_PORT.fullmatch(target):
            # Sockets of this machine and resolvers of other sorts are the caller's to choose, not a server's.
            return None
        secure = self.credentials is not None
        readable = self.token is not None and not (secure or self.allow_insecure_token or _loopback(target))
        if readable or _unspecified(target) or by_scheme not in (None, secure):
            return None
        return replace(self, target=target)


def accesses(address: str | Sequence[str], **said: Any) -> tuple[Access, ...]:  # noqa: ANN401
    """One access for each server; the others are for when the first is away."""
    given = [address] if isinstance(address, str) else address
    if not (isinstance(given, Iterable) and all(isinstance(each, str) for each in given)):
        message = f"address is {address!r}; give host:port, e.g. '127.0.0.1:50051', or a list of such"
        raise WrongType(message, reason="ADDRESS_INVALID", field="address")
    addresses = list(given)
    if not addresses:
        raise InvalidArgument("address names no server; give one", reason="ADDRESS_INVALID", field="address")
    first, *others = (access(each, **said) for each in addresses)
    for each, other in zip(addresses[1:], others, strict=True):
        if (other.credentials is None) != (first.credentials is None):
            message = f"one of {addresses[0]} and {each} asks for TLS, the other does not; write them alike"
            raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field="address")
    targets = dict.fromkeys(each.target for each in (first, *others))
    return tuple(replace(first, target=target) for target in targets)


def access(
    address: str,
    *,
    token: str | None,
    token_file: FilePath | None,
    allow_insecure_token: bool,
    tls: bool | None,
    ca_file: FilePath | None,
    cert_file: FilePath | None,
    key_file: FilePath | None,
    credentials: grpc.ChannelCredentials | None,
) -> Access:
    """Puts together what the client was told; contradictions are refused."""
    target, by_scheme = _target(address)
    files = {"ca_file": ca_file, "cert_file": cert_file, "key_file": key_file}
    given = next((name for name, file in files.items() if file is not None), None)
    if credentials is not None and given is not None:
        message = f"credentials and {given} exclude each other; give one of them"
        raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field=given)
    secure = credentials is not None or given is not None
    for field, said in (("tls", tls), ("address", by_scheme)):
        if said is False and secure:
            message = f"{given or 'credentials'} turns TLS on, but {field} turns it off; change one of them"
            raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field=field)
        secure = secure or bool(said)
    if tls is False and by_scheme:
        message = f"address {address} asks for TLS, but tls is False; change one of them"
        raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field="tls")
    source = _token(token, token_file)
    if source is not None and not (secure or allow_insecure_token or _loopback(target)):
        message = (
            f"a token would travel readably to {address}; use https://, or allow_insecure_token=True if the "
            "network is trusted"
        )
        raise InvalidArgument(message, reason="TOKEN_UNPROTECTED", field="address")
    if secure and credentials is None:
        credentials = _tls(ca_file, cert_file, key_file)
    return Access(
        target=target, credentials=credentials, token=source, allow_insecure_token=allow_insecure_token
    )


def _target(address: str) -> tuple[str, bool | None]:
    """The address as gRPC has it, and whether its form asks for TLS (None: it does not say)."""
    scheme, separator, rest = address.partition("://")
    if (separator and scheme not in _SCHEMES) or address.startswith(_GRPC_FORMS):
        return address, None
    host = (rest if separator else address).rstrip("/")
    if not host or any(c in "/@," or c.isspace() for c in host):
        message = (
            f"address {address!r} is not host:port or https://host:port; write it so, and several as a list"
        )
        raise InvalidArgument(message, reason="ADDRESS_INVALID", field="address")
    if host.count(":") > 1 and not host.startswith("["):
        host = f"[{host}]"
    if host.endswith("]") or ":" not in host:
        host = f"{host}:{DEFAULT_PORT}"
    return host, _SCHEMES.get(scheme) if separator else None


def _host(target: str) -> str:
    if target.startswith(("ipv4:", "ipv6:")):
        target = target[5:]
    return target.rpartition("/")[2].removeprefix("dns:").rpartition(":")[0].strip("[]").lower()


def _unspecified(target: str) -> bool:
    """Whether that is where a server listens, and not where it is."""
    try:
        return ipaddress.ip_address(_host(target)).is_unspecified
    except ValueError:
        return False


def _loopback(target: str) -> bool:
    """Whether what is sent there stays on this machine."""
    if target.startswith(("unix:", "unix-abstract:")):
        return True
    if re.match("dns://[^/]", target):
        # Whom another resolver calls so is not known.
        return False
    host = _host(target)
    if host == "localhost" or host.endswith(".localhost"):
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _tls(
    ca_file: FilePath | None, cert_file: FilePath | None, key_file: FilePath | None
) -> grpc.ChannelCredentials:
    if (cert_file is None) != (key_file is None):
        missing = "key_file" if key_file is None else "cert_file"
        message = f"{missing} is missing; a client certificate needs its certificate and its key"
        raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field=missing)
    return grpc.ssl_channel_credentials(
        root_certificates=None if ca_file is None else read_file("ca_file", ca_file),
        private_key=None if key_file is None else read_file("key_file", key_file),
        certificate_chain=None if cert_file is None else read_file("cert_file", cert_file),
    )


def read_file(field: str, path: FilePath) -> bytes:
    """A file's bytes."""
    try:
        return pathlib.Path(path).read_bytes()
    except OSError as cause:
        message = f"{field} {os.fspath(path)} cannot be read: {cause.strerror or cause}"
        raise InvalidArgument(message, reason="FILE_UNREADABLE", field=field) from cause


class Token:
    """A bearer token, or the file that holds it, which is read again when it changed."""

    def __init__(self, token: str | None, path: FilePath | None) -> None:
        self._path = path
        self._seen: tuple[int, ...] = ()
        if path is None:
            self._header = _bearer("token", token or "")
        else:
            self._seen = _version(os.stat(path)) if os.path.exists(path) else ()
            self._header = self._read(path)

    def header(self) -> str:
        """What the `authorization` header says now."""
        if self._path is not None:
            try:
                version = _version(os.stat(self._path))
                if version != self._seen:
                    self._header = self._read(self._path)
                    self._seen = version
            except (OSError, InvalidArgument):
                # It is being replaced; until that is done the token of before is as good as any.
                pass
        return self._header

    @staticmethod
    def _read(path: FilePath) -> str:
        return _bearer("token_file", read_file("token_file", path).decode("utf-8", "replace"))


def _version(stat: os.stat_result) -> tuple[int, ...]:
    return stat.st_mtime_ns, stat.st_size, stat.st_ino


def _token(token: str | None, token_file: FilePath | None) -> Token | None:
    if token is not None and token_file is not None:
        message = "token and token_file exclude each other; give one of them"
        raise InvalidArgument(message, reason="OPTIONS_CONFLICT", field="token_file")
    return None if token is None and token_file is None else Token(token, token_file)


def _bearer(field: str, text: str) -> str:
    token = text.strip()
    # What may stand in a header; the token itself is not repeated, for messages are logged.
    if not token or not token.isascii() or not token.isprintable() or " " in token:
        message = f"{field} holds no token: one word of printable ASCII is expected"
        raise InvalidArgument(message, reason="TOKEN_INVALID", field=field)
    return f"Bearer {token}"
