"""Modbus over TLS, as Modbus/TCP Security has it: the server shows a certificate, and so does each client."""

import ssl

from cell.errors import error
from daemon.config.faces import ModbusSection


def tls_context(config: ModbusSection) -> ssl.SSLContext | None:
    """None where the section has no certificate; ``CONFIG_INVALID`` for files that cannot be used."""
    if config.tls_cert is None:
        return None
    try:
        context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=config.tls_clients_ca)
        context.load_cert_chain(config.tls_cert, config.tls_key, password="")
    except (OSError, ssl.SSLError) as exc:
        where = "[modbus] tls_cert, tls_key or tls_clients_ca"
        raise error("CONFIG_INVALID", f"{where} cannot be used: {exc}") from exc
    context.verify_mode = ssl.CERT_REQUIRED
    return context
