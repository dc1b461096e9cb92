"""Speculative evaluation of the candidates of adaptive simulated annealing.

A candidate either improves on the best or misses, and what comes next in either case is known before its cost is: the
future is a binary tree whose nodes are candidates.  A free thread evaluates the likeliest node not begun yet.  Most
of these follow misses alone; when improvements are frequent, the one after an improvement is likelier than the tenth
miss in a row.  When a cost arrives, the branches that it rules out are no longer wanted, and their evaluations may be
abandoned at once, even while earlier candidates are still running.

Which nodes are evaluated depends on the timing.  Which are visited does not: they are the path through the tree that
the costs dictate, the same that one evaluation at a time takes.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from typing import TYPE_CHECKING

import numpy as np

from .ask_tell import Answer

if TYPE_CHECKING:
    from .annealing import AdaptiveSimulatedAnnealing

RECENT = 100  # visits from which the probability of an improvement is estimated


class Candidate:
    """A node of the tree: a vector `x` (D,) that the search may visit."""

    __slots__ = ("answer", "begun", "best", "iteration", "miss", "next", "since_progress", "x")

    def __init__(self, x: np.ndarray, iteration: int, miss: float, since_progress: int, best: Candidate | None) -> None:
        self.x, self.iteration, self.miss, self.since_progress = x, iteration, miss, since_progress
        self.best: Candidate = best or self  # around which this one was drawn
        self.begun = False
        self.answer: tuple[float, str] | None = None  # cost and status once known
        self.next: dict[bool, Candidate | None] = {}  # by whether this one improves; None where the search is over

    @property
    def improves(self) -> bool | None:
        """True if it is better than the best before it; None while that is not known."""
        if self.answer is None:
            return None
        if not np.isfinite(self.answer[0]):
            return False
        return None if self.best.answer is None else bool(self.answer[0] < self.best.answer[0])


class Speculation:
    """The candidates of a search, for evaluation by any number of threads.

    Each thread runs::

        while (candidate := candidates.take()) is not None:
            candidates.give(candidate, fun(candidate.x))

    `search`: an `AdaptiveSimulatedAnnealing`, from whose present state it starts and which it does not change;
    `visits` returns the visited candidates.
    """

    def __init__(self, search: AdaptiveSimulatedAnnealing) -> None:
        self.begun = 0  # evaluations
        self._search = search
        self._changed = threading.Condition()
        self._root: Candidate | None = None  # the next candidate to be visited
        self._alive: set[Candidate] = set()  # candidates begun that may still be visited
        self._visits: list[tuple[np.ndarray, tuple[float, str]]] = []  # not handed out yet
        self._recent = [False] * RECENT
        self._closed = search.status is not None
        if not self._closed:
            best = Candidate(search.best_x, search.iteration - 1, search.miss, search.since_progress, None)
            best.answer = search.best_f, ""
            self._root = self._drawn(search.iteration, search.miss, search.since_progress, best)

    def take(self, wait: bool = True) -> Candidate | None:
        """Return the likeliest candidate that has not been taken.

        If all possible ones are being evaluated, wait for a new one, or return None unless `wait`.
        Returns None when the search is over.
        """
        with self._changed:
            while not self._closed:
                candidate = self._likeliest()
                if candidate is not None:
                    candidate.begun = True
                    self.begun += 1
                    self._alive.add(candidate)
                    return candidate
                if not wait:
                    return None
                self._changed.wait()
        return None

    def wanted(self, candidate: Candidate) -> bool:
        """Return whether the search may still visit a candidate; if not, its evaluation may be abandoned."""
        with self._changed:  # `_alive` is made anew while an answer is taken in
            return candidate in self._alive and not self._closed

    def give(self, candidate: Candidate, answer: Answer) -> None:
        """Take the cost of a candidate, or (cost, status)."""
        with self._changed:
            candidate.answer = answer if isinstance(answer, tuple) else (answer, "")
            if candidate in self._alive and not self._closed:
                self._advance()
                self._changed.notify_all()

    def visits(self, wait: bool = True) -> list[tuple[np.ndarray, tuple[float, str]]]:
        """Return x and (cost, status) of the candidates visited since the last call, in order.

        If there are none, wait for one unless the search is over; or return none unless `wait`.
        """
        with self._changed:
            while wait and not self._visits and not self._closed:
                self._changed.wait(0.1)  # on Windows nothing interrupts a longer one
            visits, self._visits = self._visits, []
            return visits

    def close(self) -> None:
        """Hand out no more candidates and want none."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def _drawn(self, iteration: int, miss: float, since_progress: int, best: Candidate) -> Candidate:
        x = self._search.candidate(iteration, best.x, miss)
        return Candidate(x, iteration, miss, since_progress, best)

    def _after(self, candidate: Candidate, improves: bool) -> Candidate | None:
        """Return the next candidate; None where the search ends."""
        if improves not in candidate.next:
            place = self._search.after(candidate.iteration, candidate.miss, candidate.since_progress, improves)
            over = self._search.ends(place[0], place[2]) is not None
            best = candidate if improves else candidate.best
            candidate.next[improves] = None if over else self._drawn(*place, best)
        return candidate.next[improves]

    def _likeliest(self) -> Candidate | None:
        """Return the likeliest candidate that was not begun, by best-first search through the tree."""
        share = (sum(self._recent) + 1) / (RECENT + 2)
        order = itertools.count()  # between equals
        heap = [] if self._root is None else [(-1.0, next(order), self._root)]
        while heap:
            chance, _, candidate = heapq.heappop(heap)
            if not candidate.begun:
                return candidate
            known = candidate.improves
            better = 0.99 if candidate.iteration == 0 else share  # x0 is better than nothing
            for improves, part in ((False, 1.0 - better), (True, better)):
                if known in (None, improves) and (following := self._after(candidate, improves)) is not None:
                    heapq.heappush(heap, (chance * (part if known is None else 1.0), next(order), following))
        return None

    def _advance(self) -> None:
        """Visit all candidates that are certain by now, and drop those that are ruled out."""
        while self._root is not None and (improves := self._root.improves) is not None:
            visited, self._root = self._root, self._after(self._root, improves)
            assert visited.answer is not None  # or `improves` would not be known
            visited.next = {}  # others hold on to it as their best
            self._visits.append((visited.x, visited.answer))
            self._recent = [*self._recent[1:], improves]
        self._closed = self._root is None
        self._alive, open_ = set(), [self._root]
        while open_:
            candidate = open_.pop()
            if candidate is not None and candidate.begun:
                self._alive.add(candidate)
                known = candidate.improves
                open_ += [c for improves, c in candidate.next.items() if known in (None, improves)]
