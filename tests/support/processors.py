"""The processors for which OpenBLAS has code of its own that this one can run."""

from featherstone_gait.core.compile.jit import instruction_set

_NEEDS = {"Sandybridge": (), "Haswell": ("AVX2", "AVX-512"), "SkylakeX": ("AVX-512",)}
PROCESSORS = tuple(name for name, sets in _NEEDS.items() if not sets or instruction_set() in sets)
