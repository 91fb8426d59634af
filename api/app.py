"""The application that `uvicorn api.app:app` serves, for the cell whose configuration `service.config.find` finds."""

from api.application import create_app
from api.logs import configure_logs
from service.config import ConfigError, find, load

configure_logs()
try:
    _path = find()
    app = create_app(load(_path), _path)
except (ConfigError, ValueError) as error:
    raise SystemExit(f"api: {error}") from None
