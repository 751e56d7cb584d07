"""Certificates for TLS between the router and those who sign in: an authority of its own for each
folder of keys.
"""

from __future__ import annotations

import datetime
import ipaddress
from collections.abc import Iterable
from typing import Self

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from mazebot.common.files.key_file import Certificate

LASTS = datetime.timedelta(days=398)
"""How long a certificate is valid: the longest that browsers accept (CA/Browser Forum, SC-31)."""
RENEWED_BEFORE = datetime.timedelta(days=30)
"""So long before its end it is made anew."""
_AUTHORITY_LASTS = datetime.timedelta(days=3650)
_CLOCKS_DIFFER = datetime.timedelta(hours=1)
"""By so much the clocks of two machines may differ."""


class Authority:
    """Signs certificates, each of which opens the router of this authority alone."""

    def __init__(self, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
        self._certificate = certificate
        self._key = key

    @classmethod
    def new(cls) -> Self:
        """One of which nobody has anything yet."""
        key = ec.generate_private_key(ec.SECP256R1())
        name = _named("mazebot")
        certificate = (
            _begun(name, name, key, _AUTHORITY_LASTS)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
            .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), False)
            .sign(key, hashes.SHA256())
        )
        return cls(certificate, key)

    @classmethod
    def of_text(cls, text: str) -> Self:
        """The one that `text` gave. Raises ValueError where it is none."""
        data = text.encode()
        certificate = x509.load_pem_x509_certificate(data)
        key = load_pem_private_key(data, None)
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise ValueError("its key is of another kind")
        return cls(certificate, key)

    @property
    def text(self) -> str:
        """Its certificate and its private key, PEM."""
        return _pem(self._certificate) + _key_pem(self._key)

    def issue(self, name: str, hosts: Iterable[str] = ()) -> Certificate:
        """A certificate for an identity; a server also has its names and addresses in it."""
        key = ec.generate_private_key(ec.SECP256R1())
        hosts = list(hosts)
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if hosts:
            purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
        authority = self._certificate.extensions.get_extension_for_class(x509.SubjectKeyIdentifier)
        left = self._certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
        certificate = (
            _begun(_named(name), self._certificate.subject, key, min(LASTS, left))
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), False)
            .add_extension(
                x509.SubjectAlternativeName([_host(one) for one in hosts or [name]]), False
            )
            .add_extension(
                x509.AuthorityKeyIdentifier.from_issuer_subject_key_identifier(authority.value),
                False,
            )
            .sign(self._key, hashes.SHA256())
        )
        return Certificate(_pem(self._certificate), _pem(certificate), _key_pem(key))

    def still_holds(self, certificate: Certificate | None, hosts: Iterable[str] = ()) -> bool:
        """Whether a certificate is of this authority and for these hosts, and ends not too soon."""
        if certificate is None:
            return False
        try:
            found = x509.load_pem_x509_certificate(certificate.certificate.encode())
            found.verify_directly_issued_by(self._certificate)
            names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except (ValueError, TypeError, InvalidSignature, x509.ExtensionNotFound):
            return False
        wanted = {_host(host) for host in hosts}
        soon = datetime.datetime.now(datetime.UTC) + RENEWED_BEFORE
        return found.not_valid_after_utc > soon and (not wanted or set(names) == wanted)


def _begun(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    lasts: datetime.timedelta,
) -> x509.CertificateBuilder:
    begin = datetime.datetime.now(datetime.UTC) - _CLOCKS_DIFFER
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(begin + lasts)
    )


def _named(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _host(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs, content_commitment=False, key_encipherment=False,
        data_encipherment=False, key_agreement=False, key_cert_sign=signs, crl_sign=signs,
        encipher_only=False, decipher_only=False,
    )  # fmt: skip


def _pem(certificate: x509.Certificate) -> str:
    return certificate.public_bytes(Encoding.PEM).decode()


def _key_pem(key: ec.EllipticCurvePrivateKey) -> str:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()).decode()
