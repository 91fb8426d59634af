"""The task: a client's description of the episode to lay out."""

from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

from wire.plant import PlantErrors

Part = Literal["tr", "rtr", "trm", "cir", "b-rtr", "b-trm"]
Conditions = Literal["standard", "easy", "search", "stiff", "transfer"]

SENSOR_DELAY_TICKS = (1, 4)
"""Smallest and largest delay of the force/torque sensor, ticks."""


@dataclass(frozen=True, slots=True)
class Task:
    """One episode. Everything not named here (hole pose, noise, grasp, plant) is drawn from `seed` under `conditions`.

    Attributes:
        seed: the same seed gives the same world, bit for bit.
        part: peg and hole.
        clearance_m: distance between peg and wall when centred, per face, m.
        conditions: set of distributions to draw from; `docs/reference/conditions.md` describes them.
        randomise_plant: draw friction, stiffness, delay, mass and contact (training); otherwise they are nominal
            (test). Not allowed with `stiff` and `transfer`, whose plant is fixed.
        sensor_delay_ticks: delay from force to sample, 1–4 ticks of 2 ms; None draws it from the seed.
        plant: errors of the plant, on top of all this; None: it has none.
    """

    seed: int
    part: Part = "tr"
    clearance_m: float = 2.0e-3
    conditions: Conditions = "standard"
    randomise_plant: bool = False
    sensor_delay_ticks: int | None = None
    plant: PlantErrors | None = None

    def to_json(self) -> dict[str, Any]:
        return asdict(self) | {"plant": None if self.plant is None else self.plant.to_json()}

    @classmethod
    def from_json(cls, document: dict[str, Any]) -> Self:
        """Build from JSON.

        Raises:
            ValueError: a field is unknown, missing or out of range; the text names it.
        """
        plant = document.get("plant")
        if plant is not None:
            document = document | {"plant": PlantErrors.from_json(plant)}
        try:
            task = cls(**document)
        except TypeError as error:
            raise ValueError(f"task: {error}") from error
        task.check()
        return task

    def check(self) -> None:
        """Raise ValueError, naming the field, for a value from which no world can be built."""
        if type(self.seed) is not int or self.seed < 0:
            raise ValueError(f"task.seed must be a non-negative integer, not {self.seed!r}")
        if self.part not in Part.__args__:
            raise ValueError(f"task.part must be one of {', '.join(Part.__args__)}, not {self.part!r}")
        if self.conditions not in Conditions.__args__:
            raise ValueError(
                f"task.conditions must be one of {', '.join(Conditions.__args__)}, not {self.conditions!r}"
            )
        if type(self.clearance_m) not in (float, int) or not 0.05e-3 <= self.clearance_m <= 6e-3:
            raise ValueError(f"task.clearance_m must lie in 0.05e-3 … 6e-3 m, not {self.clearance_m!r}")
        if type(self.randomise_plant) is not bool:
            raise ValueError(f"task.randomise_plant must be true or false, not {self.randomise_plant!r}")
        if self.randomise_plant and self.conditions in ("stiff", "transfer"):
            raise ValueError(
                f"task.randomise_plant must be false under conditions {self.conditions!r}: their plant is given"
            )
        delay = self.sensor_delay_ticks
        if delay is not None and (
            type(delay) is not int or not SENSOR_DELAY_TICKS[0] <= delay <= SENSOR_DELAY_TICKS[1]
        ):
            low, high = SENSOR_DELAY_TICKS
            raise ValueError(f"task.sensor_delay_ticks must be null or an integer from {low} to {high}, not {delay!r}")
        if self.plant is not None:
            self.plant.check()
