"""A minimizer that calls its cost function, turned inside out: a generator that is told the costs.

The minimizer runs in a thread of its own, which waits whenever we go on and the other way round: never do both run, so
that nothing depends on the threads' timing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from queue import SimpleQueue
from threading import Thread

import numpy as np

from featherstone_gait.search.generations import Method

Evaluate = Callable[[Sequence[np.ndarray]], list[float]]
Questions = SimpleQueue[Sequence[np.ndarray] | BaseException | None]
Answers = SimpleQueue[list[float] | None]


def inverted(minimize: Callable[[Evaluate], None]) -> Method:
    """Yield what ``minimize(evaluate)`` evaluates; send the costs.

    `evaluate` takes a list of candidates and returns a list of costs.  What the minimizer raises is raised here.  When
    the generator is closed, or no longer referred to, the minimizer ends at its next evaluation.
    """
    questions: Questions = SimpleQueue()
    answers: Answers = SimpleQueue()
    Thread(target=_work, args=(minimize, questions, answers), name="minimizer", daemon=True).start()
    try:
        while (question := questions.get()) is not None:
            if isinstance(question, BaseException):
                raise question
            answers.put((yield question))
    finally:
        answers.put(None)


def _work(minimize: Callable[[Evaluate], None], questions: Questions, answers: Answers) -> None:
    def evaluate(candidates: Sequence[np.ndarray]) -> list[float]:
        questions.put(candidates)
        costs = answers.get()
        if costs is None:
            raise SystemExit  # ends the minimizer
        return costs

    try:
        minimize(evaluate)
        questions.put(None)
    except SystemExit:
        return
    except Exception as error:
        questions.put(error)
