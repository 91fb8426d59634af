"""Insertions in several processes, one core each."""

import contextlib
import multiprocessing
import signal
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
import numpy.typing as npt

from training.environment.vector import Ended, EndlessCells, EndlessInsertions, Float32Array, Step, WorkerJob

MakeInsertions = Callable[[int], EndlessInsertions]
"""A picklable function that makes the cells of worker number i."""
END_S = 5.0


class WorkerError(RuntimeError):
    """A worker process ended or failed; the text holds its message."""


class ParallelInsertions:
    """`EndlessCells` spread evenly over worker processes and stepped at the same time.

    Args:
        make: makes each worker's cells, the same number for all.
        workers: number of worker processes.

    Raises:
        WorkerError: the cells could not be made.
    """

    def __init__(self, make: MakeInsertions, workers: int) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipes: list[Connection] = []
        self._processes: list[Any] = []
        for number in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, make, number), daemon=True)
            process.start()
            theirs.close()
            self._pipes.append(ours)
            self._processes.append(process)
        try:
            sizes = self._answers()
        except WorkerError:
            self.close()
            raise
        each, self.feature_size, self.action_size = sizes[0]
        self.n = each * workers
        self.workers = workers

    def reset(self) -> Float32Array:
        self._ask([None] * self.workers)
        return np.concatenate(self._answers())

    def step(self, action: npt.NDArray[Any]) -> Step:
        self._ask(np.split(action, self.workers))
        steps: list[Step] = self._answers()
        return Step(
            np.concatenate([step.features for step in steps]),
            np.concatenate([step.reward for step in steps]),
            np.concatenate([step.done for step in steps]),
            Ended.joined([step.ended for step in steps]),
        )

    def run(self, jobs: Sequence[WorkerJob]) -> list[Any]:
        results: list[Any] = [None] * len(jobs)
        self._ask([tuple(jobs[number :: self.workers]) for number in range(self.workers)])
        for number, done in enumerate(self._answers()):
            results[number :: self.workers] = done
        return results

    def close(self) -> None:
        for pipe in self._pipes:
            pipe.close()
        for process in self._processes:
            process.join(timeout=END_S)
            if process.is_alive():
                process.terminate()
                process.join()

    def _ask(self, requests: Sequence[Any]) -> None:
        """Send each worker its request."""
        for number, (pipe, request) in enumerate(zip(self._pipes, requests, strict=True)):
            try:
                pipe.send(request)
            except OSError as error:
                raise WorkerError(f"worker {number} has ended; what it said stands above") from error

    def _answers(self) -> list[Any]:
        """Return one answer of each worker; all are received before a failure is raised."""
        answers: list[Any] = []
        for number, pipe in enumerate(self._pipes):
            try:
                answers.append(pipe.recv())
            except (EOFError, OSError) as error:
                raise WorkerError(f"worker {number} has ended; what it said stands above") from error
        for number, answer in enumerate(answers):
            if isinstance(answer, _Failure):
                raise WorkerError(f"worker {number}: {answer.text}")
        return answers


def start(make: MakeInsertions, workers: int) -> EndlessCells:
    """Start the cells in `workers` processes, or in this process if it is a single worker."""
    return make(0) if workers == 1 else ParallelInsertions(make, workers)


class _Failure:
    def __init__(self, error: Exception) -> None:
        self.text = f"{type(error).__name__}: {error}"


def _work(pipe: Connection, make: MakeInsertions, number: int) -> None:
    """Serve requests until the pipe closes: None resets, an action steps, and a tuple of jobs is run."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C and closes the pipe
    with contextlib.suppress(EOFError, ConnectionError):  # the parent has ended
        try:
            cells = make(number)
        except Exception as error:  # the parent reports it, whatever it is
            pipe.send(_Failure(error))
            return
        pipe.send((cells.n, cells.feature_size, cells.action_size))
        while True:
            request = pipe.recv()
            try:
                pipe.send(_answer(cells, request))
            except Exception as error:  # as above
                pipe.send(_Failure(error))


def _answer(cells: EndlessInsertions, request: "tuple[WorkerJob, ...] | npt.NDArray[Any] | None") -> Any:
    if request is None:
        return cells.reset()
    if isinstance(request, tuple):
        return [job() for job in request]
    return cells.step(request)
