"""What an audit trail records, parted by whose events they are, and the certificates in it."""

from cryptography import x509
from cryptography.hazmat.primitives.hashes import SHA256

from libmodbus_py.serve import AuditEvent
from libmodbus_py.tools.certificates import Identity


class Events(list[AuditEvent]):
    """The events of peers, and in `own` those of the server itself."""

    def __init__(self) -> None:
        self.own: list[AuditEvent] = []

    def append(self, event: AuditEvent) -> None:
        (super() if event.peer else self.own).append(event)


def identity_fields(event: AuditEvent) -> tuple[str | None, ...]:
    """Return what an event has of a certificate."""
    return event.subject, event.serial, event.issuer, event.fingerprint


def certificate_fields(identity: Identity | None) -> tuple[str | None, ...]:
    """Return what events must have of a certificate."""
    if identity is None:
        return (None,) * 4
    certificate = x509.load_pem_x509_certificate(identity.pem)
    fingerprint = certificate.fingerprint(SHA256()).hex()
    subject, issuer = certificate.subject.rfc4514_string(), certificate.issuer.rfc4514_string()
    return subject, f"{certificate.serial_number:x}", issuer, fingerprint
