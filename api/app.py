"""The application that `uvicorn api.app:app` serves: the cell of `$DSL_ASSEMBLY_CONFIG`, else of `config/cell.toml`."""

import os
from pathlib import Path

from api.application import create_app
from api.logs import configure_logs
from service.config import DEFAULT_PATH, PATH_VARIABLE, ConfigError, load

configure_logs()
_path = Path(os.environ.get(PATH_VARIABLE, DEFAULT_PATH)).resolve()
try:
    app = create_app(load(_path), _path)
except (ConfigError, ValueError) as error:
    raise SystemExit(f"api: {error}") from None
