"""Modbus over TLS: a client shows a certificate of the cell's authority, or says nothing at all."""

import shutil
import ssl
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError
from pymodbus.client import ModbusTcpClient, ModbusTlsClient

from cell.errors import CellError
from daemon.config import ModbusSection
from daemon.modbus.tls import tls_context
from tests.kit.certificates import authority, certificate
from tests.unit.daemon.test_modbus_clients import serve

pytestmark = [
    pytest.mark.wire,
    pytest.mark.skipif(shutil.which("openssl") is None, reason="openssl is not installed"),
]


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An authority with certificates for the cell and its PLC, and somebody else's authority with one."""
    folder = tmp_path_factory.mktemp("keys")

    for name, signed in (("ca", ("cell", "plc")), ("other", ("stranger",))):
        authority(folder, name)
        for each in signed:
            certificate(folder, each, name)
    return folder


def section(keys: Path, **other: str) -> dict[str, str]:
    files = {"tls_cert": "cell.pem", "tls_key": "cell.key", "tls_clients_ca": "ca.pem", **other}
    return {key: str(keys / name) for key, name in files.items()}


def client(keys: Path, host: str, port: int, name: str | None) -> ModbusTlsClient:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.load_verify_locations(keys / "ca.pem")
    if name is not None:
        context.load_cert_chain(keys / f"{name}.pem", keys / f"{name}.key")
    return ModbusTlsClient(host, port=port, sslctx=context, timeout=2.0, retries=0)


def reads(made: Any) -> bool:
    """Whether the client gets the run's number out of the status block."""
    try:
        return bool(made.connect()) and list(made.read_input_registers(10, count=2).registers) == [1, 4464]
    except Exception:  # whatever a library makes of a connection that is closed
        return False
    finally:
        made.close()


def test_a_plc_with_a_certificate_reads_and_commands_and_nobody_else_does(keys: Path) -> None:
    def visit(host: str, port: int) -> None:
        plc = client(keys, host, port, "plc")
        assert plc.connect()
        assert list(plc.read_input_registers(10, count=2).registers) == [1, 4464]
        assert not plc.write_registers(0, [1, 1, 3]).isError()
        plc.close()
        assert not reads(client(keys, host, port, "stranger"))
        assert not reads(client(keys, host, port, None))
        assert not reads(ModbusTcpClient(host, port=port, timeout=2.0, retries=0)), "in plain text"
        assert reads(client(keys, host, port, "plc")), "afterwards, too"

    assert [command.job for command in serve(visit, **section(keys))] == [3]


def test_files_that_are_not_what_they_should_be_are_named(keys: Path) -> None:
    for wrong in ({"tls_cert": "none.pem"}, {"tls_key": "plc.key"}, {"tls_clients_ca": "ca.key"}):
        with pytest.raises(CellError, match="tls_clients_ca"):
            tls_context(ModbusSection.model_validate(section(keys, **wrong)))


def test_a_certificate_without_an_authority_for_clients_is_refused(keys: Path) -> None:
    half = section(keys)
    del half["tls_clients_ca"]
    with pytest.raises(ValidationError, match="belong together"):
        ModbusSection.model_validate(half)
