"""The API of a cell under a flood of HTTP requests, while a block lasts."""

from collections.abc import Generator
from contextlib import contextmanager

from benchmarks.harness.processes import running
from benchmarks.stands.shipped_cell import ShippedCell

CONNECTIONS = 16
LONGEST_S = 7200.0


@contextmanager
def serving_api(shipped: ShippedCell) -> Generator[str]:
    """Run the API beside a control process that already runs; yield its port."""
    port = str(shipped.config.api.port)
    environment = shipped.environment
    with running("uvicorn", "api.app:app", "--port", port, ready="Uvicorn running", environment=environment):
        yield port


@contextmanager
def flooded(shipped: ShippedCell) -> Generator[None]:
    """Run the API and send it GET requests on `CONNECTIONS` connections, each after the answer to the last."""
    with serving_api(shipped) as port, running("benchmarks.stands.flood", port, str(LONGEST_S), str(CONNECTIONS)):
        yield
