"""The folder of keys and certificates: one for the authority, one for each bearer, to be handed out whole.

::

    ca/      key.pem  certificate.pem                       stays where certificates are made
    router/  key.pem  certificate.pem  ca.pem  zenoh.json5
    sim/     the same; so vision/, control/, camera/, recorder/, operator/ and whoever else is named

Private keys are readable by their owner alone, and a key that is there is never replaced unless that is asked for.
Nothing is signed for what somebody else could have put there: folders that others can write to, links, keys that
others can read, and certificates that are not of this authority are refused.
"""

import fcntl
import os
import re
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec

from armsight.topics import WHO
from armsight_operator.certs import authority
from armsight_operator.certs.authority import Signed
from armsight_operator.certs.layout import CA_COPY, CERTIFICATE, CONFIGURATION, KEY, ROUTER
from armsight_operator.errors import CertificateError

ROLES = (ROUTER, *WHO)
"""What a bearer may be: the router, or one of those to whom the contract's table gives rights."""

EXPIRES_SOON = timedelta(days=14)

_CA = "ca"
_NAME = re.compile(r"[a-z0-9][a-z0-9-]{0,62}")


@dataclass(frozen=True, slots=True)
class Entry:
    """One certificate of the folder."""

    name: str
    role: str
    hosts: tuple[str, ...]
    expires: datetime
    trouble: str
    """Why it can't be used, or soon no more; empty when it is well."""


class Folder:
    """Keys and certificates on disk."""

    def __init__(self, path: Path) -> None:
        """Nothing is read or written yet."""
        self.path = path

    def make(
        self,
        bearers: Mapping[str, str],
        hosts: Sequence[str],
        days: int,
        ca_days: int,
        more_hosts: Sequence[str] = (),
    ) -> dict[str, Literal["made", "kept"]]:
        """Makes what is missing, the authority as well.

        Args:
            bearers: role by name.
            hosts: names and addresses of every router.
            more_hosts: further ones of the first router.
            days: how long certificates hold.
            ca_days: how long the authority holds.

        Returns:
            What was done, by name.

        Raises:
            CertificateError: a name or role that can't be, or files that can't be read or written.
        """
        for name, role in bearers.items():
            _check(name, role)
            if role != ROUTER and name in (*hosts, *more_hosts):
                raise CertificateError(f"{name} is a name of the router's: a {role} of that name would pass for it")
        with self._alone():
            done: dict[str, Literal["made", "kept"]] = {}
            if not self._has_authority():
                self._write_authority(authority.make_authority(ca_days))
                done[_CA] = "made"
            signer = self._authority()
            for name, role in bearers.items():
                if (self.path / name / CERTIFICATE).exists():
                    _check_kept(name, role, authority.role_of(self._own_certificate(name, signer.certificate)))
                    done[name] = "kept"
                    continue
                own = (*hosts, *more_hosts) if name == ROUTER else hosts if role == ROUTER else (name,)
                self._issue(signer, name, role, tuple(dict.fromkeys(own)), days)
                done[name] = "made"
            return done

    def renew(
        self, names: Iterable[str], days: int, hosts: Sequence[str] = (), *, new_keys: bool = False
    ) -> dict[str, datetime]:
        """Signs new certificates, for the keys that are there unless new ones are asked for.

        Args:
            names: whose; none: everybody's.
            days: how long they hold.
            hosts: further names and addresses of the routers that are named, or of the first.
            new_keys: replace the private keys, too.

        Returns:
            When each expires, by name.

        Raises:
            CertificateError: a name without a certificate, an expired authority, or files that can't be used.
        """
        wanted = tuple(names)
        with self._alone():
            signer = self._authority()
            known = self.names()
            if unknown := sorted(set(wanted) - set(known)):
                raise CertificateError(
                    f"{self.path} has no certificate of {', '.join(unknown)}: it has {', '.join(known)}"
                )
            expires = {}
            for name in wanted or known:
                old = self._own_certificate(name, signer.certificate)
                role = authority.role_of(old)
                more = hosts if role == ROUTER and (name == ROUTER or name in wanted) else ()
                own = tuple(dict.fromkeys((*authority.hosts_of(old), *more)))
                expires[name] = self._issue(signer, name, role, own, days, new_key=new_keys).not_valid_after_utc
            return expires

    def names(self) -> tuple[str, ...]:
        """Who has a certificate, the router first."""
        found = sorted(file.parent.name for file in self.path.glob(f"*/{CERTIFICATE}") if file.parent.name != _CA)
        return tuple(sorted(found, key=lambda name: name != ROUTER))

    def roles(self) -> dict[str, str]:
        """What each bearer may do, by name; nobody where there is no authority yet.

        Raises:
            CertificateError: a certificate that is not of this authority, or in another's folder.
        """
        if not self._has_authority():
            return {}
        signer = _read_certificate(self.path / _CA / CERTIFICATE)
        return {name: authority.role_of(self._own_certificate(name, signer)) for name in self.names()}

    def entries(self, now: datetime | None = None) -> list[Entry]:
        """Every certificate, with what is wrong with it.

        A folder that was handed out has its own alone.

        Raises:
            CertificateError: there is none, or one can't be read.
        """
        now = now or datetime.now(UTC)
        if (self.path / CERTIFICATE).exists():
            return [_entry(self.path, _read_certificate(self.path / CA_COPY), now)]
        if not self._has_authority():
            raise CertificateError(f"{self.path} has no certificates: `armsight certs make` makes them")
        signer = _read_certificate(self.path / _CA / CERTIFICATE)
        key = self.path / _CA / KEY  # may well be kept elsewhere
        trouble = (_trouble_with_key(key) if key.exists() else "") or _trouble_with_time(signer, now)
        own = Entry(_CA, "", (), signer.not_valid_after_utc, trouble)
        return [own, *(_entry(self.path / name, signer, now) for name in self.names())]

    def write_configuration(self, name: str, text: str) -> None:
        """Writes a bearer's Zenoh configuration, in the place of the last one."""
        _write(self.path / name / CONFIGURATION, text.encode(), 0o644)

    def _issue(
        self, signer: Signed, name: str, role: str, hosts: Sequence[str], days: int, *, new_key: bool = False
    ) -> x509.Certificate:
        folder = _private_folder(self.path / name)
        file = folder / KEY
        is_kept = file.exists() and not new_key
        key = _read_own_key(file) if is_kept else authority.make_key()
        certificate = authority.sign(signer, key.public_key(), name, role, hosts, days, serves=role == ROUTER)
        if not is_kept:
            _write(file, authority.to_pem(key), 0o600)
        _write(folder / CA_COPY, _pem(signer.certificate), 0o644)
        _write(folder / CERTIFICATE, _pem(certificate), 0o644)
        return certificate

    def _own_certificate(self, name: str, signer: x509.Certificate) -> x509.Certificate:
        """What may be signed again: what it says was said by this authority, of whom the folder is named after."""
        file = self.path / name / CERTIFICATE
        certificate = _read_certificate(file)
        if not _is_signed_by(signer, certificate) or authority.name_of(certificate) != name:
            raise CertificateError(f"{file} is not what this CA signed for {name}: remove the folder to make it anew")
        return certificate

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """While nobody else makes or renews certificates here."""
        folder = os.open(_private_folder(self.path), os.O_RDONLY | os.O_DIRECTORY)
        try:
            fcntl.flock(folder, fcntl.LOCK_EX)
            yield
        finally:
            os.close(folder)

    def _has_authority(self) -> bool:
        return (self.path / _CA / CERTIFICATE).exists()

    def _authority(self) -> Signed:
        folder = self.path / _CA
        if not self._has_authority():
            raise CertificateError(f"{self.path} has no CA: `armsight certs make` makes one")
        return Signed(_read_own_key(folder / KEY), _read_certificate(folder / CERTIFICATE))

    def _write_authority(self, signed: Signed) -> None:
        folder = _private_folder(self.path / _CA)
        if (folder / KEY).exists():
            raise CertificateError(f"{folder} has a key without its certificate: remove the folder to make a new CA")
        _write(folder / KEY, authority.to_pem(signed.key), 0o600)
        _write(folder / CERTIFICATE, _pem(signed.certificate), 0o644)


def _check(name: str, role: str) -> None:
    if not _NAME.fullmatch(name) or name == _CA:
        raise CertificateError(f"{name!r} can't be a name: letters a to z, digits and '-', and not {_CA!r}")
    if role not in ROLES:
        raise CertificateError(f"{name} can't act as {role!r}: there are {', '.join(ROLES)}")
    if name in ROLES and name != role:
        raise CertificateError(f"{name} is a name of the system: it can't act as {role}")


def _check_kept(name: str, role: str, found: str) -> None:
    if found != role:
        raise CertificateError(
            f"{name} has a certificate as {found}, not as {role}: take another name, for rights go by names, and who "
            f"has the old certificate would have those of {role} until it expires"
        )


def _entry(folder: Path, signer: x509.Certificate, now: datetime) -> Entry:
    certificate = _read_certificate(folder / CERTIFICATE)
    return Entry(
        name=authority.name_of(certificate),
        role=authority.role_of(certificate),
        hosts=authority.hosts_of(certificate),
        expires=certificate.not_valid_after_utc,
        trouble=_trouble(folder, certificate, signer) or _trouble_with_time(certificate, now),
    )


def _trouble(folder: Path, certificate: x509.Certificate, signer: x509.Certificate) -> str:
    if not _is_signed_by(signer, certificate):
        return "not signed by this CA"
    if _read_certificate(folder / CA_COPY) != signer:
        return f"{CA_COPY} is of another CA: renew it"
    key = folder / KEY
    if not os.access(key, os.R_OK):
        return f"{KEY} is missing or can't be read by this user"
    if _read_key(key).public_key() != certificate.public_key():
        return f"{KEY} is another certificate's: renew it"
    return _trouble_with_key(key)


def _trouble_with_key(key: Path) -> str:
    return f"{KEY} can be read by others: chmod 600" if key.stat().st_mode & 0o077 else ""


def _is_signed_by(signer: x509.Certificate, certificate: x509.Certificate) -> bool:
    try:
        certificate.verify_directly_issued_by(signer)
    except (InvalidSignature, TypeError, ValueError):
        return False
    return True


def _trouble_with_time(certificate: x509.Certificate, now: datetime) -> str:
    left = certificate.not_valid_after_utc - now
    if left <= timedelta(0):
        return "expired: renew it"
    if certificate.not_valid_before_utc > now:
        return "not valid yet: check this machine's clock"
    return f"expires in {left.days} days: renew it" if left < EXPIRES_SOON else ""


def _private_folder(path: Path) -> Path:
    """A folder in which nobody else can put anything, made where there is none."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise CertificateError(f"can't make {path}: {error.strerror}") from error
    if stat.S_ISLNK(found.st_mode):
        raise CertificateError(f"{path} is a link: name the folder itself")
    if found.st_uid not in (os.geteuid(), 0):
        raise CertificateError(f"{path} belongs to another user, who could put keys of his own there")
    if found.st_mode & 0o022:
        raise CertificateError(f"others can write to {path}, and put keys of their own there: chmod 700 {path}")
    return path


def _write(path: Path, content: bytes, mode: int) -> None:
    """Whole or not at all, and never readable by more than ``mode`` says."""
    part = path.with_name(f".{path.name}.part")
    try:
        part.unlink(missing_ok=True)
        with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        raise CertificateError(f"can't write {path}: {error.strerror}") from error


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise CertificateError(f"can't read {path}: {error.strerror}") from error


def _read_certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(_read(path))
    except ValueError as error:
        raise CertificateError(f"{path} is not a certificate in PEM form") from error


def _read_own_key(path: Path) -> ec.EllipticCurvePrivateKey:
    """One to sign with or for: nobody else has it."""
    if path.is_symlink():
        raise CertificateError(f"{path} is a link: put the key itself there")
    key = _read_key(path)
    if trouble := _trouble_with_key(path):
        raise CertificateError(f"{path.parent}: {trouble}, or remove it to make a new one")
    return key


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(_read(path), password=None)
    except (ValueError, TypeError) as error:  # what is wrong with a key is not for a log
        raise CertificateError(f"{path} is not a private key in PEM form") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise CertificateError(f"{path} is not a key that `armsight certs` made")
    return key
