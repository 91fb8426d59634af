"""The cells of one training worker, in a module of their own because a worker loads no torch."""

from training.environment.episodes import TaskSource
from training.environment.insertion import Insertions
from training.environment.vector import EndlessInsertions
from training.learning.experiment import Experiment


def make_cells(experiment: Experiment, seed: int, steps: int, worker: int) -> EndlessInsertions:
    """Make the cells of worker number `worker`; all play the same part of the experiment.

    A training that goes on after `steps` steps draws other episodes than at its beginning.
    """
    task, algorithm = experiment.task, experiment.algorithm
    part = task.parts[worker % len(task.parts)]
    insertions = Insertions(
        experiment.contract(),
        algorithm.cells // algorithm.workers,
        part,
        force_ceiling_n=task.force_ceiling_n,
        reward_name=task.reward,
        force_cost_per_n=task.force_cost_per_n,
        slips=task.slips,
        misreads=task.misreads,
    )
    source = TaskSource(part, task.clearance_m, task.conditions, task.randomise_plant)
    return EndlessInsertions(insertions, source, [seed, worker, steps])
