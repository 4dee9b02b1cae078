"""The certificate of a service, for TLS."""

import ssl

from delfim.base.errors import PermanentFailure


def server_tls(certificate: str, key: str) -> ssl.SSLContext | None:
    """Load the certificate that `key` of the vehicle's file names; none: no TLS. Raises PermanentFailure if the file is missing
    or not a certificate with its key."""
    if not certificate:
        return None
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH)
    try:
        context.load_cert_chain(certificate)
    except (OSError, ssl.SSLError) as error:
        raise PermanentFailure(f"{key}: {certificate}: {error.strerror or error}") from None
    return context
