"""The kinds of scenes that quick tests simulate.  Each takes 2 to 15 s of compiling, so there are few.

What a run is compiled for depends on which parts of scene, signals and workspace are there, not on their numbers.
kinds.toml lists the kinds by name.  A quick test that simulates another one fails, and says in what it differs from the
nearest.  Then give its scene the same parts (a friction of zero is a part, too), or mark the test `long`.
"""

import functools
import tomllib
from pathlib import Path

import pytest

from featherstone_gait.core.compile.jit import JIT
from featherstone_gait.core.compile.varying import Varying
from featherstone_gait.run import fleet
from featherstone_gait.run.compiled_run import CompiledRun

LIST = Path(__file__).with_name("kinds.toml")
LARGEST = 30_000  # instructions of an optimized function; LLVM takes more than in proportion beyond
NOTING = 60_000  # of one that notes each operation of a step for its derivative (adjoint.py)
running = []  # the test that runs, if it is a quick one


@functools.cache
def listed():
    """Return the parts of each kind, by name."""
    return {name: frozenset(words.split()) for name, words in tomllib.loads(LIST.read_text("utf-8")).items()}


def kind_of(kernel, run):
    """Return the kernel, the integrator and the parts that are present; `~` marks numbers that vary between lanes."""
    words = {kernel.__name__, type(run.work).__name__}
    for name in ("scene", "signals"):
        words.update(_parts(getattr(run, name), ()))
    words.update(_parts(run.plan.min_height, ("min_height",)))
    words.update(_parts(run.renewal, ("renewal",)))
    words.update(("frames",) if run.frames is not None else ())
    words.update(name for name in ("predicted", "fresh") if getattr(run.work, name, None) is not None)
    return frozenset(words)


def _parts(x, path):
    if x is None:
        return
    fields = getattr(x, "_fields", range(len(x)) if isinstance(x, tuple) else None)
    if fields is None:
        yield ".".join(path)
    elif isinstance(x, Varying):
        yield ".".join(path) + "~"
    else:
        for field, part in zip(fields, x):
            yield from _parts(part, (*path, str(field)))


def guard(monkeypatch):
    """Fail quick tests that simulate an unlisted kind, and any test that compiles too large a function."""
    call, direct = CompiledRun.call, fleet.direct

    def check(kernel, run):
        if running and (kind := kind_of(kernel, run)) not in listed().values():
            pytest.fail(_unlisted(kind), pytrace=False)

    def checked(self, kernel, run, y, out):
        check(kernel, run)
        return call(self, kernel, run, y, out)

    def checked_direct(kernel, run, *arguments):  # of sessions
        check(kernel, run)
        return direct(kernel, run, *arguments)

    monkeypatch.setattr(CompiledRun, "call", checked)
    monkeypatch.setattr(fleet, "direct", checked_direct)
    if JIT:
        from featherstone_gait.core.compile.compiler import Whole

        finalize = Whole.finalize

        def counted(self):
            finalize(self)
            sizes = [(_instructions(one), one.name) for one in self._final_module.functions if not one.is_declaration]
            size, name = max(sizes, default=(0, ""))
            most = NOTING if "adjoint" in name else LARGEST
            assert size <= most, f"{name} has {size} instructions; keep a function that it calls `apart` (jit.py)"

        monkeypatch.setattr(Whole, "finalize", counted)


def _instructions(function):
    return sum(sum(1 for _ in block.instructions) for block in function.blocks)


def _unlisted(kind):
    name, nearest = min(listed().items(), key=lambda one: len(one[1] ^ kind), default=("none", frozenset()))
    return (
        f"a quick test simulates a kind of scene that {LIST.name} does not list: nearest is {name!r}, here with "
        f"{' '.join(sorted(kind - nearest)) or 'nothing'} and without {' '.join(sorted(nearest - kind)) or 'nothing'}; "
        f"give the scene the parts of a listed kind, or mark the test long. This kind: {' '.join(sorted(kind))}"
    )
