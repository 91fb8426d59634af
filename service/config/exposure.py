"""Endpoints that strangers could reach, or that lack their certificates."""

from collections.abc import Iterator

from service.config.sections import CameraSection, CellSection, SimSection, TlsSection
from wire.endpoints import is_local
from wire.tls import is_encrypted


def unprotected(
    cell: CellSection, sim: SimSection, camera: CameraSection | None, tls: TlsSection | None
) -> Iterator[str]:
    """Yield endpoints that lack their certificates, and a control process that anybody on the network could command."""
    named = {"cell.endpoint": cell.endpoint, "sim.endpoint": sim.endpoint}
    if camera is not None:
        named["camera.endpoint"] = camera.endpoint
    for name, endpoint in named.items():
        if is_encrypted(endpoint) and tls is None:
            yield f"{name} is {endpoint}, so the section [tls] must name the certificates"
    if not is_encrypted(cell.endpoint) and not is_local(cell.endpoint):
        yield (
            f"cell.endpoint is {cell.endpoint}: whoever reaches it commands the cell. Use tls/ and the section [tls], "
            "or an address of this machine such as tcp/127.0.0.1:7447"
        )
