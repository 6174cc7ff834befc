"""A certificate authority in a folder, for servers and callers of a test."""

from __future__ import annotations

import datetime
import ipaddress
import pathlib

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

DAY = datetime.timedelta(days=1)
#: What `names` may begin with.
_KINDS = {
    "DNS": x509.DNSName,
    "IP": lambda text: x509.IPAddress(ipaddress.ip_address(text)),
    "URI": x509.UniformResourceIdentifier,
}
PURPOSES = {"client": ExtendedKeyUsageOID.CLIENT_AUTH, "server": ExtendedKeyUsageOID.SERVER_AUTH}


class Authority:
    """Signs certificates; `ca` is its own, PEM."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.folder = folder
        folder.mkdir(exist_ok=True)
        self._key, self.ca = ec.generate_private_key(ec.SECP256R1()), folder / "ca.pem"
        name = _named("test authority")
        basic = x509.BasicConstraints(ca=True, path_length=0)
        made = _builder(name, name, self._key, (-DAY, 2 * DAY)).add_extension(basic, critical=True)
        self._certificate = made.sign(self._key, hashes.SHA256())
        self.ca.write_bytes(self._certificate.public_bytes(serialization.Encoding.PEM))

    def issue(
        self,
        name: str,
        names: str = "",
        *,
        valid: tuple[datetime.timedelta, datetime.timedelta] = (-DAY, DAY),
        purpose: str | None = None,
        file: str | None = None,
    ) -> tuple[pathlib.Path, pathlib.Path]:
        """Certificate and key of the common name `name` and of `names`, such as `DNS:a,IP:127.0.0.1`, in
        files that are called so, or `file`; `valid` from and until, from now."""
        key = ec.generate_private_key(ec.SECP256R1())
        builder = _builder(_named(name), self._certificate.subject, key, valid)
        if names:
            others = [_KINDS[kind](text) for kind, _, text in (one.partition(":") for one in names.split(","))]
            builder = builder.add_extension(x509.SubjectAlternativeName(others), critical=False)
        if purpose:
            builder = builder.add_extension(x509.ExtendedKeyUsage([PURPOSES[purpose]]), critical=False)
        made = builder.sign(self._key, hashes.SHA256())
        cert_file, key_file = (self.folder / f"{file or name}.{end}" for end in ("pem", "key"))
        form = serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        cert_file.write_bytes(made.public_bytes(serialization.Encoding.PEM))
        key_file.write_bytes(key.private_bytes(serialization.Encoding.PEM, *form))
        return cert_file, key_file


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _builder(subject, issuer, key, valid) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.timezone.utc)
    return (
        x509.CertificateBuilder(issuer, subject, key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now + valid[0])
        .not_valid_after(now + valid[1])
    )
