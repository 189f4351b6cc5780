"""TLS for the control API: certificate and key of a daemon, and whom its clients trust."""

import ssl
from pathlib import Path
from typing import Final

from axistwin.errors import UsageError

CA_VARIABLE: Final = "AXISTWIN_CONTROL_CA"


def server_context(certificate: str, key: str | None) -> ssl.SSLContext:
    """What a server with the ``certificate`` in that file serves with.

    key: the file of its private key; None: it is in the file of the certificate.  Raises
    UsageError.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    _read("control certificate", certificate)
    key_file = key if key is not None else certificate
    text = _read("control key", key_file)
    if b"PRIVATE KEY-----" not in text:
        raise UsageError(f"control key {key_file}: no private key in PEM form is in it")
    if b"ENCRYPTED" in text:  # OpenSSL would ask at the terminal for its password
        raise UsageError(f"control key {key_file}: it has a password; give a key without one")
    try:
        context.load_cert_chain(certificate, key)
    except ssl.SSLError as error:
        if error.reason == "KEY_VALUES_MISMATCH":
            told = f"the key in {key_file} does not belong to it; give the key it was made with"
        elif error.reason in ("NO_START_LINE", None):
            told = "no certificate in PEM form is in it, or no key behind it"
        else:
            told = f"OpenSSL refuses it or its key ({error.reason})"
        raise UsageError(f"control certificate {certificate}: {told}") from None
    return context


def client_context(authority: str | None) -> ssl.SSLContext:
    """What a client asks with that trusts the certificates in the file ``authority``.

    None: those that the machine trusts.  Raises UsageError.
    """
    if authority is None:
        return ssl.create_default_context()
    _read("control CA", authority)
    try:
        return ssl.create_default_context(cafile=authority)
    except ssl.SSLError:
        raise UsageError(f"control CA {authority}: no certificate in PEM form is in it") from None


def _read(what: str, path: str) -> bytes:
    try:
        return Path(path).read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"{what} {path}: cannot be read ({reason}); give a file in PEM") from None
