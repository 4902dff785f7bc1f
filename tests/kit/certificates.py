"""Certificates for tests of TLS, made by openssl: an authority, and keys that it has signed."""

import subprocess
from pathlib import Path

_NEW = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes")


def authority(folder: Path, name: str) -> None:
    """``NAME.pem`` and ``NAME.key`` in ``folder``."""
    _openssl(folder, "req", "-x509", *_NEW, "-days", "2", "-subj", f"/CN={name}",
             "-keyout", f"{name}.key", "-out", f"{name}.pem")  # fmt: skip


def certificate(folder: Path, name: str, by: str, host: str = "") -> None:
    """``NAME.pem`` and ``NAME.key``, signed by the authority ``by``; for ``host`` where one is given."""
    names = folder / f"{name}.names"
    names.write_text(f"subjectAltName=DNS:{host}\n" if host else "")
    _openssl(folder, "req", *_NEW, "-subj", f"/CN={name}", "-keyout", f"{name}.key", "-out", f"{name}.csr")
    _openssl(folder, "x509", "-req", "-in", f"{name}.csr", "-CA", f"{by}.pem", "-CAkey", f"{by}.key",
             "-CAcreateserial", "-days", "2", "-extfile", names.name, "-out", f"{name}.pem")  # fmt: skip


def _openssl(folder: Path, *words: str) -> None:
    subprocess.run(["openssl", *words], check=True, capture_output=True, timeout=20, cwd=folder)
