"""A certificate authority of our own and the certificates that it signs: X.509, keys on the curve P-256.

The common name of a certificate says who its bearer is, the organizational unit what its bearer may do.
"""

import ipaddress
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from armsight_operator.errors import CertificateError

_ORGANIZATION = "armsight"
_CLOCK_SKEW = timedelta(minutes=5)
"""A certificate holds from a little before it was made: clocks of two machines differ."""
_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(?<!-)(\.(?!-)[A-Za-z0-9-]{1,63}(?<!-))*")


@dataclass(frozen=True, slots=True)
class Signed:
    """A private key and the certificate of its public half."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate


def make_authority(days: int, now: datetime | None = None) -> Signed:
    """A new authority that signs for itself.

    Args:
        days: how long it holds.
        now: when it begins to hold (default: now).
    """
    now = now or datetime.now(UTC)
    key = ec.generate_private_key(ec.SECP256R1())
    # every authority has a name of its own, so that "unknown issuer" and "bad signature" are not confused
    name = _name(f"armsight CA {x509.random_serial_number():032x}"[:28], "ca")
    certificate = (
        _builder(name, name, key.public_key(), days, now)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(key_cert_sign=True, crl_sign=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    return Signed(key, certificate)


def make_key() -> ec.EllipticCurvePrivateKey:
    """A new private key."""
    return ec.generate_private_key(ec.SECP256R1())


def sign(
    authority: Signed,
    public_key: ec.EllipticCurvePublicKey,
    name: str,
    role: str,
    hosts: Sequence[str],
    days: int,
    now: datetime | None = None,
    *,
    serves: bool = False,
) -> x509.Certificate:
    """A certificate to connect with, and for a router also to be connected to.

    Args:
        authority: who signs.
        public_key: of the bearer.
        name: who the bearer is: the subject of the router's rules.
        role: what the bearer may do.
        hosts: names and addresses under which the bearer is reached.
        days: how long it holds; no longer than the authority does.
        now: when it begins to hold (default: now).
        serves: whether others may take the bearer for a router.

    Raises:
        CertificateError: the authority has expired, or a host is neither a name nor an address.
    """
    now = now or datetime.now(UTC)
    if authority.certificate.not_valid_after_utc <= now:
        raise CertificateError(
            f"the CA expired on {authority.certificate.not_valid_after_utc:%Y-%m-%d}: "
            "make a new one in another folder, and hand out its certificates"
        )
    issuer = authority.certificate
    usage = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if serves else [])]
    return (
        _builder(_name(name, role), issuer.subject, public_key, days, now, latest=issuer.not_valid_after_utc)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(digital_signature=True), critical=True)
        .add_extension(x509.ExtendedKeyUsage(usage), critical=False)
        .add_extension(x509.SubjectAlternativeName([_alternative(host) for host in hosts]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(public_key), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key()), critical=False)
        .sign(authority.key, hashes.SHA256())
    )


def name_of(certificate: x509.Certificate) -> str:
    """Who the bearer is."""
    return _attribute(certificate, NameOID.COMMON_NAME)


def role_of(certificate: x509.Certificate) -> str:
    """What the bearer may do."""
    return _attribute(certificate, NameOID.ORGANIZATIONAL_UNIT_NAME)


def hosts_of(certificate: x509.Certificate) -> tuple[str, ...]:
    """Names and addresses under which the bearer is reached."""
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return tuple(str(name.value) for name in names)


def to_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    """A private key as a file holds it."""
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    days: int,
    now: datetime,
    latest: datetime | None = None,
) -> x509.CertificateBuilder:
    until = now + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _CLOCK_SKEW)
        .not_valid_after(min(until, latest) if latest else until)
    )


def _name(name: str, role: str) -> x509.Name:
    return x509.Name(
        [
            x509.NameAttribute(NameOID.ORGANIZATION_NAME, _ORGANIZATION),
            x509.NameAttribute(NameOID.ORGANIZATIONAL_UNIT_NAME, role),
            x509.NameAttribute(NameOID.COMMON_NAME, name),
        ]
    )


def _usage(*, digital_signature: bool = False, key_cert_sign: bool = False, crl_sign: bool = False) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=digital_signature,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=key_cert_sign,
        crl_sign=crl_sign,
        encipher_only=False,
        decipher_only=False,
    )


def _alternative(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    if not _HOST_NAME.fullmatch(host):
        raise CertificateError(f"{host!r} is neither a host's name nor its address")
    return x509.DNSName(host)


def _attribute(certificate: x509.Certificate, which: x509.ObjectIdentifier) -> str:
    found = certificate.subject.get_attributes_for_oid(which)
    return str(found[0].value) if found else ""
