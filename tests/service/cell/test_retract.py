from pathlib import Path

from service.drivers.base import PoseTarget, Sample
from service.messages import CellState, RunState
from service.safety.pose import wrap, yaw_and_tilt
from service.testing import cell_config, lockstep_cell
from tests.service.cell.faulty_driver import FaultyDriver

SHIPPED = Path(__file__).parents[3] / "models" / "vftm-dsl.onnx"


class WatchedDriver(FaultyDriver):
    """Keeps every target with the newest true sample of that moment."""

    def __init__(self, driver) -> None:
        super().__init__(driver)
        self.sent: list[tuple[PoseTarget, Sample]] = []

    def send_target(self, target: PoseTarget) -> int:
        self.sent.append((target, self.truth))
        return super().send_target(target)


async def test_a_peg_is_pulled_out_as_it_stands_and_not_as_it_was_last_pressed_and_turned(tmp_path: Path) -> None:
    """A peg that is pulled while it is twisted against its hole jams."""
    config = cell_config(tmp_path, SHIPPED, clearance_m=1.33e-3)
    async with lockstep_cell(config, wrap=WatchedDriver) as bench:
        run = await bench.insert(seed=18)
        assert run.state is RunState.SUCCEEDED, run.text
        assert bench.cell.state is CellState.READY
        sent = bench.cell.driver.sent
        last = next(i for i, (target, _) in enumerate(sent) if target is bench.records[-1].target)
        pressed, (pulled, measured) = sent[last][0], sent[last + 1]
        assert pressed.position[2] < measured.tcp_position[2] - 3e-3 < pulled.position[2]
        assert _turned(pressed, measured) > 0.015 > 0.005 > _turned(pulled, measured)
        truth = bench.world.truth()
        assert truth["depth"] < -0.010  # out of the hole, and standing above it
        assert max(point.force_peak_n for point in bench.telemetry) < 20.0


def _turned(target: PoseTarget, sample: Sample) -> float:
    return abs(float(wrap(yaw_and_tilt(target.rotvec)[0] - yaw_and_tilt(sample.tcp_rotvec)[0])))
