"""Adaptive simulated annealing: a random search around the best point so far, with re-heating.

The candidate of iteration ``k`` is ``best + amplitude * u_k / miss`` with ``u_k`` uniform in [-1, 1) per component.
A lower cost is accepted and sets ``miss`` to 1; any other adds 1 to it, so that the search narrows; when it reaches
``max_miss`` it drops to 0.1, which throws the next candidate ten amplitudes wide.  Despite the name there is no
temperature, and nothing worse is ever accepted.

Reference: J. Lima et al., "Humanoid gait optimization resorting to an improved simulation model", Int. J. Advanced
Robotic Systems 10 (2013), figure 14.  What the printed pseudo-code leaves open or has wrong, and how it is mended:

- ``neighbor(s) / miss`` would shrink the state itself: only the perturbation is divided;
- ``s`` is never updated: candidates are drawn around the best state;
- the best cost is never initialized: the initial state is evaluated first, as iteration 0;
- ``miss = MAXMISS`` is tested for equality, which 0.1, 1.1, 2.1, ... never meet, so that re-heating happens once:
  ``>=`` is used;
- ``MISS`` and ``miss`` are the same variable;
- the loop ends at KMAX where the text ends "after a predetermined number of iterations without progress": both;
- ``return`` stands inside the loop;
- a cost that is not a number compares as neither better nor worse: not a number and infinity are misses.

The noise ``u_k`` is a function of (seed, k) alone and ``miss`` of the history of misses.  Hence the candidates that may
come are known in advance and can be evaluated at once, in batches that assume that all miss or as `speculation` orders
them, and the sequence of states visited does not depend on which are.  The cost is taken to be deterministic: one lucky
noisy value would stay the best for ever.
"""

from __future__ import annotations

import json
import logging
import os
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult
from tqdm import tqdm

from featherstone_gait.base.arguments import floats, functions, is_whole, path, shown, truth, whole
from featherstone_gait.base.files import claim, is_number, parse_json
from featherstone_gait.search.ask_tell import Cost, Map, check_map
from featherstone_gait.search.speculation import Speculation

SEEDS = 2**128  # of Philox
REHEATED = 0.1  # miss count after max_miss misses (figure 14)
MESSAGES = {
    0: "max_iterations reached",
    1: "no progress for no_progress iterations",
    2: "interrupted; the best so far is returned",
    3: "stopped by the callback",
}
SYNCED = 1.0  # between moments at which the history is known to be on the disk, at least [s]
REMEDY = "delete this line and all below to resume before it"
_log = logging.getLogger(__name__)


class Visit(NamedTuple):
    """A state of the search."""

    iteration: int
    x: np.ndarray  # (D,)
    f: float
    miss: float  # that divided its perturbation
    accepted: bool


class AdaptiveSimulatedAnnealing:
    """The search as ask and tell, one candidate or a speculative batch at a time.

    `x0` (D,); `amplitude` of the perturbation, a number or (D,), in x0's units; `bounds` (D, 2) or None; `seed` a
    whole number from 0 to below 2**128.  Candidates beyond a bound are reflected at it: clipping would pile them up on
    the bounds, where half of all later perturbations of that component are lost.  Raises ValueError for settings out of
    range.
    """

    def __init__(
        self,
        x0: ArrayLike,
        *,
        amplitude: ArrayLike,
        max_miss: int = 20,
        max_iterations: int = 3000,
        no_progress: int = 500,
        bounds: ArrayLike | None = None,
        seed: int = 0,
    ) -> None:
        self.x0, self.amplitude = np.array(floats("x0", x0)), np.array(floats("amplitude", amplitude))
        self.bounds = None if bounds is None else np.array(floats("bounds", bounds))
        self.max_miss, self.max_iterations, self.no_progress, self.seed = max_miss, max_iterations, no_progress, seed
        self._check()
        self.best_x, self.best_f = self.x0.copy(), np.inf
        self.iteration = 0  # of the next candidate; 0 is x0
        self.miss = 1.0
        self.since_progress = 0
        self.wasted = 0  # evaluations begun for candidates that were not visited
        self.visited: list[Visit] = []  # every Visit so far
        self._asked: list[np.ndarray] = []

    @property
    def status(self) -> int | None:
        """None while there is more to do, else the key of `MESSAGES`."""
        return self.ends(self.iteration, self.since_progress)

    def ends(self, iteration: int, since_progress: int) -> int | None:
        """The `status` before a candidate of that iteration, that many misses after the last improvement."""
        if iteration > self.max_iterations:
            return 0
        return 1 if since_progress >= self.no_progress else None

    def candidate(self, iteration: int, best_x: np.ndarray, miss: float) -> np.ndarray:
        """The candidate (D,) of an iteration around `best_x`."""
        if iteration == 0:
            return self.x0.copy()
        x = best_x + self.amplitude * _noise(self.seed, iteration, len(self.x0)) / miss
        return x if self.bounds is None else _reflect(x, *self.bounds.T)

    def after(self, iteration: int, miss: float, since_progress: int, better: bool) -> tuple[int, float, int]:
        """Iteration, miss and misses since progress after a candidate that is the new best or not."""
        if better or iteration == 0:
            return iteration + 1, 1.0, 0
        return iteration + 1, REHEATED if miss + 1.0 >= self.max_miss else miss + 1.0, since_progress + 1

    def ask(self) -> np.ndarray:
        """Return the next candidate (D,).  Raises RuntimeError when the search is over."""
        return self.ask_batch(1)[0]

    def ask_batch(self, k: int) -> list[np.ndarray]:
        """Return up to `k` next candidates, as they will be if all miss; fewer if the search would end before."""
        if self.status is not None:
            raise RuntimeError(f"the search is over: {MESSAGES[self.status]}")
        place, self._asked = (self.iteration, self.miss, self.since_progress), []
        while len(self._asked) < k and self.ends(place[0], place[2]) is None:
            self._asked.append(self.candidate(place[0], self.best_x, place[1]))
            place = self.after(*place, False)
        return [x.copy() for x in self._asked]

    def tell(self, x: ArrayLike, f: float) -> bool:
        """Take the cost `f` of the candidate `x` that `ask` returned; return whether it is the new best."""
        if len(self._asked) != 1 or not np.array_equal(x, self._asked[0]):
            raise ValueError("tell: x is not the candidate that was asked for; ask first and tell it unchanged")
        return self._visit(self._asked.pop(), f)

    def tell_batch(self, fs: Sequence[float]) -> int:
        """Take the costs of the candidates of `ask_batch`, up to the first improvement; return how many were taken.

        The others were drawn around a state that is no longer the best; they are dropped and counted as wasted.
        Raises ValueError unless there is one cost a candidate.
        """
        if len(fs) != len(self._asked) or not self._asked:
            raise ValueError(f"tell_batch: {len(fs)} costs for {len(self._asked)} candidates asked for")
        asked, self._asked = self._asked, []
        taken = 0
        for x, f in zip(asked, fs):
            first = self.iteration == 0
            better = self._visit(x, f)
            taken += 1
            if better and not first:
                break
        self.wasted += len(asked) - taken
        return taken

    def _check(self) -> None:
        if self.x0.ndim != 1 or not len(self.x0) or not np.isfinite(self.x0).all():
            raise ValueError(f"x0 must be a finite (D,) array with D > 0, got shape {self.x0.shape}")
        if self.amplitude.shape not in ((), self.x0.shape):
            raise ValueError(f"amplitude must be a number or {self.x0.shape}, got shape {self.amplitude.shape}")
        self.amplitude = np.array(np.broadcast_to(self.amplitude, self.x0.shape))
        if not (np.isfinite(self.amplitude) & (self.amplitude > 0)).all():
            raise ValueError(f"amplitude must be finite and > 0, got {self.amplitude}")
        for name, least in (("max_miss", 2), ("max_iterations", 0), ("no_progress", 1), ("seed", 0)):
            value = getattr(self, name)
            if not is_whole(value) or not least <= value < SEEDS:
                raise ValueError(f"{name} = {shown(value)} must be a whole number >= {least} and below 2**128")
            setattr(self, name, int(value))
        if self.seed >= 2**128:
            raise ValueError(f"seed = {self.seed} must be a whole number below 2**128")
        if self.bounds is None:
            return
        if self.bounds.shape != (len(self.x0), 2):
            raise ValueError(f"bounds must be ({len(self.x0)}, 2) as x0 is, got {self.bounds.shape}")
        outside = ~((self.bounds[:, 0] <= self.x0) & (self.x0 <= self.bounds[:, 1]))
        if outside.any():
            i = int(outside.argmax())
            raise ValueError(f"x0[{i}] = {self.x0[i]} lies outside its bounds {self.bounds[i, 0]}..{self.bounds[i, 1]}")

    def _visit(self, x: np.ndarray, f: float) -> bool:
        better = bool(np.isfinite(f) and f < self.best_f)
        if better:
            self.best_x, self.best_f = x, float(f)
        self.visited.append(Visit(self.iteration, x, float(f), self.miss, better))
        self.iteration, self.miss, self.since_progress = self.after(
            self.iteration, self.miss, self.since_progress, better
        )
        return better


def _noise(seed: int, iteration: int, n: int) -> np.ndarray:
    """Return n numbers uniform in [-1, 1) that depend on seed and iteration alone.

    They are made from Philox's raw 64 bits, which NumPy promises to keep, unlike what its distributions make of them.
    """
    raw = np.random.Philox(key=seed, counter=[0, iteration, 0, 0]).random_raw(n)
    return (raw >> np.uint64(11)) * 2.0**-52 - 1.0


def _reflect(x: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Fold `x` back between its bounds, as often as it takes; infinite bounds fold nothing."""
    x = np.where(x < lower, 2.0 * lower - x, x)
    x = np.where(x > upper, 2.0 * upper - x, x)
    outside = (x < lower) | (x > upper)
    if outside.any():
        a, width = lower[outside], (upper - lower)[outside]
        turn = np.mod(x[outside] - a, 2.0 * width, where=width > 0.0, out=np.zeros_like(a))
        x[outside] = a + np.minimum(turn, 2.0 * width - turn)
    return np.clip(x, lower, upper)  # against the last bit


def minimize(
    fun: Cost | None,
    x0: ArrayLike,
    *,
    amplitude: ArrayLike,
    max_miss: int = 20,
    max_iterations: int = 3000,
    no_progress: int = 500,
    bounds: ArrayLike | None = None,
    seed: int = 0,
    map: Map = map,
    batch: int = 1,
    evaluate: Callable[[Speculation], object] | None = None,
    callback: Callable[[OptimizeResult], bool | None] | None = None,
    history: str | os.PathLike[str] | None = None,
    resume: bool = False,
    progress: bool = False,
) -> OptimizeResult:
    """Minimize `fun` by adaptive simulated annealing and return a `scipy.optimize.OptimizeResult`.

    `fun(x)` returns the cost, or (cost, status) with a short text for the history; a cost that is not finite is a miss.
    The states visited depend on the settings of `AdaptiveSimulatedAnnealing` and not on how they are evaluated: `batch`
    candidates at a time through ``map(fun, candidates)``, for which any executor's ``map`` will do, or without waiting
    for one another by ``evaluate(candidates)``, which works off a `Speculation` and returns when that is over.

    `callback(result)` is called at every improvement and stops the search by returning True.  `history` names a file
    of JSON lines, each written before the next candidate is visited and holding nothing that depends on the time; with
    `resume` the search goes on from it (from `x0` if there is none), to the same states and the same file as if never
    interrupted; only max_iterations and no_progress may differ.  `progress` shows a bar.

    The result has x, fun, nit (candidates after x0), nfev (evaluations begun, wasted ones included), wasted (not
    visited; of these two a history knows nothing), success, status (a key of `MESSAGES`), message, and history: arrays
    x (nit + 1, D), f, miss and accepted.  KeyboardInterrupt ends the search with what was found.  Raises
    FileExistsError for a `history` that would be overwritten, ValueError for one of another search or a damaged one,
    OSError for one that cannot be written, whose lines so far are kept, or with which another process is at work.
    """
    search = AdaptiveSimulatedAnnealing(
        x0, amplitude=amplitude, max_miss=max_miss, max_iterations=max_iterations, no_progress=no_progress,
        bounds=bounds, seed=seed,
    )  # fmt: skip
    batch = whole("batch", batch, 1, "it is how many candidates are evaluated at once")
    functions(fun=fun, map=map, evaluate=evaluate, callback=callback)
    if evaluate is None:
        check_map(fun, map)
    progress = truth("progress", progress)
    resume = truth("resume", resume)
    history = None if history is None else path("history", history)
    log = None if history is None else _History(Path(history), search, resume)
    status = None
    bar = tqdm(total=max_iterations + 1, initial=search.iteration, disable=not progress, unit="candidate")
    steps = _in_batches(search, fun, map, batch) if evaluate is None else _speculating(search, evaluate)
    try:
        for texts in steps:
            visits = search.visited[-len(texts) :]
            if log is not None:
                log.write(visits, texts)
            bar.update(search.iteration - bar.n)
            improved = any(visit.accepted for visit in visits)
            if improved:
                bar.set_postfix(best=search.best_f)
            if improved and callback is not None and callback(_result(search, None)):
                status = 3
                break
    except KeyboardInterrupt:
        status = 2
    finally:
        steps.close()
        bar.close()
        if log is not None:
            log.close()
    return _result(search, search.status if status is None else status)


def _in_batches(search: AdaptiveSimulatedAnnealing, fun: Cost | None, map: Map, batch: int) -> Generator[list[str]]:
    """Evaluate batch after batch; yield the statuses of the candidates visited."""
    while search.status is None:
        candidates = search.ask_batch(batch)
        answers = [answer if isinstance(answer, tuple) else (answer, "") for answer in map(fun, candidates)]
        taken = search.tell_batch([f for f, _ in answers])
        yield [text for _, text in answers[:taken]]


def _speculating(search: AdaptiveSimulatedAnnealing, evaluate: Callable[[Speculation], object]) -> Generator[list[str]]:
    """Let `evaluate` run in a thread of its own; yield the status of each candidate visited."""
    candidates, before = Speculation(search), search.wasted - len(search.visited)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(evaluate, candidates)
        done.add_done_callback(lambda _: candidates.close())
        try:
            while visits := candidates.visits():
                for _, (f, text) in visits:
                    search.tell(search.ask(), f)
                    search.wasted = before + candidates.begun - len(search.visited)
                    yield [text]
        finally:
            candidates.close()
    done.result()  # raises what it raised
    if search.status is None:
        raise RuntimeError("evaluate returned before the search was over")


def _result(search: AdaptiveSimulatedAnnealing, status: int | None) -> OptimizeResult:
    visited = search.visited
    arrays = {
        "x": np.array([visit.x for visit in visited]).reshape(-1, len(search.x0)),
        "f": np.array([visit.f for visit in visited]),
        "miss": np.array([visit.miss for visit in visited]),
        "accepted": np.array([visit.accepted for visit in visited], dtype=bool),
    }
    found = bool(np.isfinite(search.best_f))
    message = ("running" if status is None else MESSAGES[status]) if found else "no candidate had a finite cost"
    return OptimizeResult(
        x=search.best_x.copy(), fun=search.best_f, nit=max(0, len(visited) - 1), nfev=len(visited) + search.wasted,
        wasted=search.wasted, success=found and status in (0, 1), status=status, message=message, history=arrays,
    )  # fmt: skip


class _History:
    """The visits of a search as JSON lines: a header with the settings, then one line a visit."""

    def __init__(self, path: Path, search: AdaptiveSimulatedAnnealing, resume: bool) -> None:
        self.path, header, self.synced = path, _header(search), time.monotonic()
        self.file = _opened(path, resume)
        try:
            claim(self.file, path)
            lines = self._complete_lines()
            if lines:
                _check_header(path, lines[0], header)
            for number, line in enumerate(lines[1:], start=2):
                _replay(path, number, line, search)
            if not lines:
                self._write_line(header)
        except BaseException:
            self.file.close()
            raise

    def write(self, visits: Iterable[Visit], texts: Iterable[str]) -> None:
        """Write visits down, and from time to time wait until they are on the disk."""
        for visit, text in zip(visits, texts):
            self._write_line(_content(visit, text))
        if time.monotonic() - self.synced > SYNCED:
            self._sync()
            self.synced = time.monotonic()

    def close(self) -> None:
        with self.file:
            self._sync()

    def _sync(self) -> None:
        try:
            os.fsync(self.file.fileno())
        except OSError:  # not a file on a disk
            pass

    def _write_line(self, content: dict[str, Any]) -> None:
        """Hand a line to the system, which keeps it whatever becomes of this process; all of it or nothing."""
        line, complete = (json.dumps(content) + "\n").encode(), self.file.seek(0, os.SEEK_END)
        try:
            while line:
                line = line[self.file.write(line) :]
        except OSError as error:
            self.file.truncate(complete)
            raise OSError(
                f"{self.path} cannot be written ({error.strerror}); it holds all candidates so far: make room, resume"
            ) from error

    def _complete_lines(self) -> list[bytes]:
        """Return the lines of the file, cutting off a last one that was not written to its end."""
        self.file.seek(0)
        data = self.file.read()
        *lines, rest = data.split(b"\n")
        if rest and not rest.startswith(b"{"):
            raise ValueError(f"{self.path}, line {len(lines) + 1}: damaged; {REMEDY}")
        if rest:
            _log.warning("%s: dropped the last line, which was cut off", self.path)
            self.file.truncate(len(data) - len(rest))
        return lines


def _opened(path: Path, resume: bool) -> IO[bytes]:
    try:
        return path.open("a+b" if resume else "x+b", buffering=0)
    except FileExistsError as error:
        remedy = "pass resume=True to go on from it, or another file name"
        raise FileExistsError(f"{path} exists; {remedy}") from error


def _content(visit: Visit, text: str) -> dict[str, Any]:
    """A visit as JSON will give it back."""
    finite = bool(np.isfinite(visit.f))
    return {
        "iteration": visit.iteration,
        "x": visit.x.tolist(),
        "f": visit.f if finite else None,
        "status": text or ("ok" if finite else "not finite"),
        "accepted": visit.accepted,
        "miss": visit.miss,
    }


def _header(search: AdaptiveSimulatedAnnealing) -> dict[str, Any]:
    """Return the settings as JSON will give them back; infinite bounds as text, for which JSON has no number."""
    bounds = None if search.bounds is None else [[_number(b) for b in pair] for pair in search.bounds.tolist()]
    return {
        "search": "adaptive simulated annealing",
        "version": 1,
        "seed": int(search.seed),
        "max_miss": int(search.max_miss),
        "max_iterations": int(search.max_iterations),
        "no_progress": int(search.no_progress),
        "amplitude": search.amplitude.tolist(),
        "bounds": bounds,
        "x0": search.x0.tolist(),
    }


def _number(value: float) -> float | str:
    return value if np.isfinite(value) else str(value)


def _check_header(path: Path, line: bytes, expected: dict[str, Any]) -> None:
    found = parse_json(line, f"{path}, line 1", REMEDY)
    if is_number(found.get("version")) and found["version"] > expected["version"]:
        raise ValueError(
            f"{path}, line 1: the history's format is {found['version']}, of a newer version, and this one reads 1 to "
            f"{expected['version']}; resume with the version that began it, or take another file name"
        )
    for key in expected:
        if key not in ("max_iterations", "no_progress") and found.get(key) != expected[key]:
            raise ValueError(
                f"{path}, line 1: the history's {key} is {found.get(key)}, but this search has {expected[key]}; "
                "resume with the settings it was begun with, or take another file name"
            )


def _replay(path: Path, number: int, line: bytes, search: AdaptiveSimulatedAnnealing) -> None:
    """Repeat a visit of the history, which must be the search's own next one."""
    content = parse_json(line, f"{path}, line {number}", REMEDY)
    if search.status is not None:
        raise ValueError(
            f"{path}, line {number}: the history is longer than this search may be ({MESSAGES[search.status]}); "
            "raise that setting, or take another file name"
        )
    x, f, text = search.ask(), content.get("f"), content.get("status")
    if content.get("iteration") != search.iteration or content.get("x") != x.tolist():
        what = f"not iteration {search.iteration} of this search; lines are missing or changed"
        raise ValueError(f"{path}, line {number}: {what}; {REMEDY}")
    if not (f is None or is_number(f)) or not isinstance(text, str) or not text:
        what = f"f is {f!r}, status {text!r}; expected a finite number or null, and a text"
        raise ValueError(f"{path}, line {number}: {what}; {REMEDY}")
    search.tell(x, np.inf if f is None else f)
    if content != _content(search.visited[-1], text):
        raise ValueError(f"{path}, line {number}: not what this search makes of a cost of {f}; {REMEDY}")
