"""A certificate for a control API in tests."""

from pathlib import Path

import trustme


class Files:
    """A CA, and a certificate of it for this machine, with its key."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        authority = trustme.CA()
        issued = authority.issue_cert("127.0.0.1", "localhost")
        self.authority, self.certificate, self.key, self.both = (
            str(folder / name) for name in ("ca.pem", "certificate.pem", "key.pem", "both.pem")
        )
        authority.cert_pem.write_to_path(self.authority)
        issued.cert_chain_pems[0].write_to_path(self.certificate)
        issued.private_key_pem.write_to_path(self.key)
        issued.private_key_and_cert_chain_pem.write_to_path(self.both)

    @property
    def options(self) -> tuple[str, ...]:
        """Of a daemon."""
        return "--control-certificate", self.certificate, "--control-key", self.key
