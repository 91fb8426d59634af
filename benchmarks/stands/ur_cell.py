"""The shipped cell with an emulated UR arm, at an address of its own."""

from collections.abc import Generator
from contextlib import contextmanager

from benchmarks.harness.processes import ROOT, free_port
from benchmarks.stands.shipped_cell import ShippedCell, shipped_cell
from service.cell.plan import Plan, plan_insertion
from service.config import CellConfig
from service.policy.model import Policy

HOST = "127.0.0.31"
"""Address of the emulated controller, which uses UR's own ports: ur_rtde supports no others."""
_CONFIG = ROOT / "config" / "ur-emulated.toml"


@contextmanager
def shipped_ur_cell(**overrides: str) -> Generator[ShippedCell]:
    """Read the configuration of the emulated UR cell, with its controller at `HOST`; starts nothing.

    Args:
        **overrides: more fields, as for `shipped_cell`.

    Raises:
        UnavailableError: the configuration cannot be read, or its policy is missing.
    """
    world = f"tcp/127.0.0.1:{free_port()}"
    fields = {"ur__host": HOST, "sim__endpoint": world, "camera__endpoint": world, "sim__autostart": "false"}
    with shipped_cell(_CONFIG, **{**fields, **overrides}) as shipped:
        yield shipped


def plan_first(config: CellConfig) -> Plan:
    """Return the plan of an insertion of the first recipe: law and limits with which the arm is engaged."""
    recipe = next(iter(config.recipes.values()))
    return plan_insertion(config, recipe, Policy.load(recipe.policy).contract)


def controller_options(shipped: ShippedCell) -> tuple[str, ...]:
    """Return options of `dsl-assembly sim ur-controller` that give it this cell's arm and world."""
    sim = shipped.config.sim
    return "ur-controller", "--host", HOST, "--world", sim.world, "--listen", sim.endpoint, "--realtime"
