"""The control process on the wire that the API's tests have, behind the commands."""

from tests.api.conftest import cell, cell_port, config_path

__all__ = ["cell", "cell_port", "config_path"]
