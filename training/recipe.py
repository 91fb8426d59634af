"""Settings of one training: what `python -m training train` offers, by default as the shipped policy was trained."""

from dataclasses import dataclass

from training.reward import RewardName


@dataclass(frozen=True, slots=True)
class Recipe:
    """Settings of one training.

    Attributes:
        steps: environment steps in all.
        cells: simulated cells stepped together, over all workers.
        workers: processes that they are spread over.
        rollout: steps per cell between two updates.
        hidden: layers of actor and critic.
        learning_rate: at the start; falls linearly to a tenth.
        threads: of the physics, per worker; 0 for one per core.
        torch_threads: of the update; 0 leaves torch's choice.
        seed: of the network, the exploration and the tasks.
    """

    steps: int = 2_500_000
    cells: int = 128
    workers: int = 2
    rollout: int = 64
    hidden: tuple[int, ...] = (256, 128)
    learning_rate: float = 5e-4
    batch: int = 2048
    epochs: int = 4
    gamma: float = 0.99
    gae_lambda: float = 0.95
    entropy: float = 1e-3
    target_kl: float | None = None
    initial_log_std: float = -0.5
    reward: RewardName = "potential"
    threads: int = 1
    torch_threads: int = 1
    seed: int = 0
    device: str = "cpu"
