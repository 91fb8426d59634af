"""An authority and its certificates, made by openssl for one test."""

import shutil
import subprocess
from pathlib import Path

from wire.tls import Certificates

EXTENSIONS = "subjectAltName=IP:127.0.0.1,DNS:localhost\nbasicConstraints=CA:FALSE\nextendedKeyUsage={usage}\n"


class Authority:
    """Signs certificates in a folder of its own; `docs/reference/wire-security.md` has the same commands."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True)
        self.folder = folder
        self.file = folder / "authority.pem"
        self._openssl("req", "-x509", *_new_key("authority"), "-days", "2", "-out", "authority.pem")

    def certify(self, name: str, usage: str = "clientAuth") -> Certificates:
        """Make key and certificate for a common name."""
        (self.folder / f"{name}.ext").write_text(EXTENSIONS.format(usage=usage))
        self._openssl("req", *_new_key(name), "-out", f"{name}.csr")
        signer = ("-CA", "authority.pem", "-CAkey", "authority.key", "-CAcreateserial", "-days", "2")
        self._openssl("x509", "-req", "-in", f"{name}.csr", *signer, "-extfile", f"{name}.ext", "-out", f"{name}.pem")
        return Certificates(self.file, self.folder / f"{name}.pem", self.folder / f"{name}.key")

    def _openssl(self, *arguments: str) -> None:
        openssl = shutil.which("openssl")
        assert openssl is not None, "the tests of TLS need openssl"
        done = subprocess.run((openssl, *arguments), cwd=self.folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr


def _new_key(name: str) -> tuple[str, ...]:
    curve = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1")
    return (*curve, "-nodes", "-keyout", f"{name}.key", "-subj", f"/CN={name}")
