"""Energy of the same gait, run after run (Lima et al. 2013, Fig. 11).

The paper walks the same gait two hundred times with each model and finds that the energy scatters by 14.62 % with the
standard model and by 3.9 % with motor inertia plus spring-damper (MIPSD).  It does not say what differs between the
runs. In this package a run is a function of its input, and two runs of the same gait have the same bits.  So the
experiment adds the scatter, one source at a time:

- initial posture: a robot is never set down twice in the same way;
- round-off: the paper's program computes in single precision; the angles that the controllers read have this error;
- contacts: its solver stops after ten sweeps over the contacts in random order and leaves a residual of the forces.
  Ours has no such order.  The residual is added as torques at the joints, drawn anew at each controller tick, of the
  size that a small share of the robot's weight has at half a foot's length (through the voltage, by R / (G K));
- encoder and supply: errors of a real servo, which the paper's program does not model.

Model and integration are separated: standard and MIPSD, each in the update order of the paper's program (`simtwo`,
explicit, in which the standard model chatters) and under `implicit_euler`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..base.progress import progress_bar
from ..run.simulate import standing_state
from ..scene.compile import GearboxKind
from ..view.style import BLUE, ORANGE, look
from ..view.style import COLORS as STYLE
from ..walking.cost import WalkingCost
from ..walking.gait import TICK
from .claim import Claim, classify, question, within
from .common import ENCODER_STEP, EXPLICIT, IMPLICIT, scale_masses, subplots
from .walks import cycle_energies, planned_walk, recompiled

Kind = tuple[GearboxKind, str]  # with the integrator
Source = str | tuple[str, float]

PAPER: dict[GearboxKind, float] = {"standard": 0.1462, "mipsd": 0.039}  # standard deviation over mean
MODELS: tuple[Kind, ...] = tuple(product(("standard", "mipsd"), (EXPLICIT, IMPLICIT)))
SOURCES = ("initial posture", "round-off", "contacts", "encoder and supply")
ALL = "all together"
FACTOR = 1.3  # within which a standard deviation counts as the same: the paper's own, over 200 runs, is good to 10 %
RESAMPLES = 2000  # of the bootstrap


@dataclass(frozen=True)
class EnergySettings:
    """Sizes of the sources, and the number of runs."""

    runs: int  # of each model with each source
    joint_noise: float = math.radians(0.1)  # [rad] standard deviation of the initial angles; a third of an encoder step
    round_off: float = 2.0**-24  # relative, half of single precision's last place; angles to 1 rad
    contact_rest: float = 0.01  # of the weight; ten sweeps reduce a rest to per cents
    foot: float = 0.05  # [m] half of a sole's length
    encoder: float = ENCODER_STEP  # [rad] step of the AX-12's encoder; noise within half of it
    ripple: float = 0.1  # [V] largest, of all servos alike; 1 % of the 10 V supply
    scales: tuple[float, ...] = (0.1, 10.0)  # all sources together, this much larger
    masses: tuple[float, ...] = (0.6, 0.8)  # of all links, times ours; the paper gives none
    steps: tuple[float, ...] = (5e-4, 2e-3)  # [s] of the explicit order, besides 1 ms; the paper gives none
    strides: int = 4  # measured
    warm_up: int = 1  # strides before them


QUICK = EnergySettings(runs=40)
FULL = EnergySettings(runs=200, scales=(0.01, 0.03, 0.1, 0.3, 3.0, 10.0), masses=(0.5, 0.6, 0.7, 0.8, 0.9))


class Scatter(NamedTuple):
    """Standard deviation of the energy over its mean, with the ends of its 95 % interval (bootstrap, percentiles)."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{_percent(self.value)} ({_percent(self.low)} to {_percent(self.high)})"


@dataclass(frozen=True, eq=False)
class EnergyResult:
    """Energies of each stride (runs, strides) [J], nan in runs that fell, by (gearbox, integrator) and source.

    Besides `SOURCES` and `ALL` the sources are (ALL, scale), ("mass", times) and ("step", seconds), with all sources.
    """

    settings: EnergySettings
    seed: int
    energies: dict[Kind, dict[Source, np.ndarray]]
    chatters: dict[Kind, int]  # runs of `ALL` that chattered
    off: dict[Kind, float]  # mean energy of `ALL` over that at a quarter of the step, undisturbed, less 1

    def energy(self, model: Kind, source: Source = ALL) -> np.ndarray:
        """Return energy of the runs that did not fall (n,) [J]."""
        energy = self.energies[model][source].sum(axis=1)
        return energy[np.isfinite(energy)]

    def fell(self, model: Kind, source: Source = ALL) -> int:
        return self.settings.runs - len(self.energy(model, source))

    def scatter(self, model: Kind, source: Source = ALL) -> Scatter:
        """Return the scatter; NaN if fewer than three runs finished."""
        energy = self.energy(model, source)
        if len(energy) < 3:
            return Scatter(math.nan, math.nan, math.nan)
        picks = np.random.default_rng(self.seed).integers(len(energy), size=(RESAMPLES, len(energy)))
        low, high = np.quantile(_relative(energy[picks]), (0.025, 0.975))
        return Scatter(float(_relative(energy)), float(low), float(high))

    def shares(self, model: Kind) -> np.ndarray:
        """Return variance of each source alone over the sum of them all (sources,)."""
        variances = np.array([self.scatter(model, source).value ** 2 for source in SOURCES])
        return variances / variances.sum()


def _relative(energy: np.ndarray) -> np.ndarray:
    return energy.std(axis=-1, ddof=1) / energy.mean(axis=-1)


def run(settings: EnergySettings = QUICK, seed: int = 0, progress: bool = False) -> EnergyResult:
    """Walk the planned gait with each model under each source; the models share the noise, seeded by `seed`."""
    energies: dict[Kind, dict[Source, np.ndarray]] = {model: {} for model in MODELS}
    chatters, off = {}, {}
    sources = [*SOURCES, ALL, *((ALL, scale) for scale in settings.scales)]
    unsaid = [*(("mass", x) for x in settings.masses), *(("step", h) for h in settings.steps)]
    cases = [(model, source) for model in MODELS for source in sources + unsaid * (model[1] == EXPLICIT)]
    planned = planned_walk()
    for model, source in progress_bar(cases, "energy", progress=progress, unit="case"):
        what, size = source if isinstance(source, tuple) else (source, 1.0)
        changed = {"mass": {"mass": size}, "step": {"timestep": size}}.get(what, {})
        cost = gait_cost(settings, planned, *model, **changed)
        states, noises = disturbed(settings, cost, ALL if changed else what, seed, 1.0 if changed else size)
        energies[model][source], statuses = _energies(cost, states, noises)
        if source == ALL:
            chatters[model] = statuses.count("chatter")
    true = {gearbox: _undisturbed(settings, planned, gearbox) for gearbox in PAPER}
    for model in MODELS:
        energy = energies[model][ALL].sum(axis=1)
        off[model] = float(np.nanmean(energy) / true[model[0]] - 1.0) if np.isfinite(energy).any() else math.nan
    return EnergyResult(settings, seed, energies, chatters, off)


def gait_cost(
    settings: EnergySettings,
    planned: WalkingCost,
    gearbox: GearboxKind,
    integrator: str,
    timestep: float = 1e-3,
    mass: float = 1.0,
) -> WalkingCost:
    """Return the planned walk with another gearbox, integrator, step and mass."""
    model, how = scale_masses(planned.scene.model, mass), {"integrator": integrator, "timestep": timestep}
    cost = recompiled(planned, model, gearbox=gearbox, **how)
    return replace(cost, warm_up=settings.warm_up, strides=settings.strides)


def _undisturbed(settings: EnergySettings, planned: WalkingCost, gearbox: GearboxKind) -> float:
    """Return the energy at a quarter of the step, integrated implicitly and undisturbed [J]."""
    cost = gait_cost(settings, planned, gearbox, IMPLICIT, 2.5e-4)
    states, noises = disturbed(replace(settings, runs=3), cost, ALL, 0, 0.0)
    return float(_energies(cost, states, noises)[0][0].sum())


def disturbed(
    settings: EnergySettings, cost: WalkingCost, source: str, seed: int, scale: float = 1.0
) -> tuple[list[np.ndarray], np.ndarray]:
    """Return initial states and noises (runs, ticks, joints, 2), `scale` times the sizes of the settings."""
    angles = cost.reference(cost.gait.to_vector(), 0).values[0]
    servo = next(iter(cost.scene.model.servos.values()))  # the same in every joint
    ticks = math.ceil(cost.end / servo.controller.period - 1e-9)
    shape = (settings.runs, ticks, len(angles))
    states = [standing_state(cost.scene, angles)] * settings.runs
    noises = np.zeros((*shape, 2))
    for k, name in enumerate(SOURCES):
        if source not in (name, ALL):
            continue
        rng = np.random.default_rng((seed, k))
        if name == "initial posture":
            off = scale * settings.joint_noise * rng.standard_normal((settings.runs, len(angles)))
            states = [standing_state(cost.scene, angles + each) for each in off]
        elif name == "round-off":
            noises[..., 0] += scale * settings.round_off * rng.uniform(-1.0, 1.0, shape)
        elif name == "contacts":
            torque = settings.contact_rest * cost.scene.model.mass * math.hypot(*cost.scene.gravity) * settings.foot
            volts = torque * servo.resistance / (servo.gearbox.ratio * servo.motor_constant)
            noises[..., 1] += scale * volts * rng.standard_normal(shape)
        else:
            noises[..., 0] += scale * 0.5 * settings.encoder * rng.uniform(-1.0, 1.0, shape)
            noises[..., 1] += scale * settings.ripple * rng.uniform(-1.0, 1.0, (*shape[:2], 1))
    return states, noises


def _energies(cost: WalkingCost, states: list, noises: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return the energy of each measured stride (runs, strides) [J], and the statuses; chatter is accepted."""
    vectors = [cost.gait.to_vector()] * len(states)
    runs = cost.simulate(vectors, record_interval=TICK, record=("energy",), states=states, noises=list(noises))
    return cycle_energies(cost, runs), [run.status for run in runs]


# ---------------------------------------------------------------------------------------------- claims


def check(result: EnergyResult) -> list[Claim]:
    """Return the claims about the paper's two figures, their ratio, and their causes."""
    return [_size(result, "standard"), _size(result, "mipsd"), _lower(result), _cause(result), _source(result)]


def _size(result: EnergyResult, gearbox: GearboxKind) -> Claim:
    """Return the claim: reproduced within `FACTOR`."""
    model: Kind = (gearbox, EXPLICIT)
    ours, paper, fell = result.scatter(model), PAPER[gearbox], result.fell(model)
    near = paper / FACTOR < ours.value < paper * FACTOR
    names = {ALL: (1.0, "times the sources"), "mass": (1.0, "times the masses"), "step": (1e3, "ms step")}
    unsaid = [(source, *names[source[0]]) for source in result.energies[model] if isinstance(source, tuple)]
    unstated = "; ".join(f"{_spread(result, model, s)} with {scale * s[1]:g} {what}" for s, scale, what in unsaid)
    return Claim(
        claim=f"Standard deviation of the energy of the same gait, {gearbox} model",
        item="Fig. 11",
        factor=ours.value / paper,
        accepted=within(FACTOR),
        paper=f"{paper:.2%} over 200 runs",
        ours=f"{ours} over {result.settings.runs - fell} runs; {fell} fell and are excluded",
        verdict=classify(near),
        why=f"Rule: within a factor {FACTOR:g}. Explicit order, as in the paper's program, with all sources; alone: "
        + ", ".join(f"{source} {result.scatter(model, source)}" for source in SOURCES)
        + f". The paper states neither what differs between runs, nor masses, nor step: {unstated}",
    )


def _spread(result: EnergyResult, model: Kind, source: Source) -> str:
    fell = result.fell(model, source)
    return f"{result.scatter(model, source)}" + (f", {fell} fell," if fell else "")


def _lower(result: EnergyResult) -> Claim:
    """Return the claim: reproduced if the intervals do not overlap and the ratio is within `FACTOR` of the paper's."""
    ratio, (standard, mipsd) = _ratio(result, EXPLICIT)
    paper = PAPER["standard"] / PAPER["mipsd"]
    apart = standard.low > mipsd.high
    near = paper / FACTOR < ratio < paper * FACTOR
    ratios = {source: _ratio(result, EXPLICIT, source)[0] for source in SOURCES}
    return Claim(
        claim="The energy repeats better with MIPSD",
        item="Fig. 11",
        factor=ratio / paper,
        accepted=within(FACTOR),
        order=True,
        paper=f"{paper:.2f} times",
        ours=f"{ratio:.2g} times ({standard} against {mipsd})",
        verdict=classify(apart and near, apart),
        why=f"Rule: 95 % intervals do not overlap, and the ratio is within a factor {FACTOR:g}; in direction if they "
        "do not overlap. By source: "
        + ", ".join(f"{source} {x:.2g} times" for source, x in ratios.items())
        + f". {result.chatters['standard', EXPLICIT]} of {result.settings.runs} runs of the standard model chatter, "
        f"{result.chatters['mipsd', EXPLICIT]} with MIPSD",
    )


def _ratio(result: EnergyResult, integrator: str, source: Source = ALL) -> tuple[float, tuple[Scatter, Scatter]]:
    standard, mipsd = (result.scatter((gearbox, integrator), source) for gearbox in ("standard", "mipsd"))
    return standard.value / mipsd.value, (standard, mipsd)


def _cause(result: EnergyResult) -> Claim:
    """Return the claim: reproduced if the intervals do not overlap when integrated implicitly either."""
    ratio, (standard, mipsd) = _ratio(result, IMPLICIT)
    apart = standard.low > mipsd.high
    explicit = result.scatter(("standard", EXPLICIT))
    gain = _percent(abs(result.off["standard", EXPLICIT]))
    return question(
        claim="The servo model causes the scatter of the energy",
        ours=f"integrated implicitly: standard {standard}, MIPSD {mipsd}, {ratio:.2g} times",
        verdict=classify(apart),
        why="Rule: the 95 % intervals of standard and MIPSD do not overlap where both are integrated implicitly "
        f"either. The same standard model scatters by {explicit} in the explicit order, where its energy differs by "
        f"{gain} from that at a quarter of the step integrated implicitly (implicit, 1 ms: "
        f"{result.off['standard', IMPLICIT]:+.1%}; MIPSD: {result.off['mipsd', EXPLICIT]:+.1%} explicit, "
        f"{result.off['mipsd', IMPLICIT]:+.1%} implicit)",
    )


def _source(result: EnergyResult) -> Claim:
    """Return the claim: reproduced if round-off alone gives at least half the scatter of all sources."""
    ours = {model: result.scatter(model, "round-off") for model in MODELS}
    model: Kind = ("standard", EXPLICIT)
    chaotic = ours[model].low > 0.5 * result.scatter(model).value
    shares = "; ".join(
        f"{_name(model)} " + ", ".join(f"{source} {share:.1%}" for source, share in zip(SOURCES, result.shares(model)))
        for model in MODELS
    )
    return question(
        claim="Round-off alone makes the energy of the standard model scatter: its chatter is chaotic",
        ours=", ".join(f"{_name(model)} {x}" for model, x in ours.items()),
        verdict=classify(chaotic),
        why="Rule: in the explicit order round-off alone gives at least half the scatter of all sources together. "
        f"Variance of each source alone, as a share of the sum of all four: {shares}",
    )


def _name(model: Kind) -> str:
    return f"{model[0]} {'explicit' if model[1] == EXPLICIT else 'implicit'}"


def _percent(x: float) -> str:
    if not math.isfinite(x):
        return "none"
    return f"{x:.2%}" if x >= 1e-3 else f"{100 * x:.1e} %"


# ---------------------------------------------------------------------------------------------- figures

COLORS = dict(zip(MODELS, (ORANGE, STYLE[5], BLUE, STYLE[4])))


@look()
def plot(result: EnergyResult) -> dict[str, Figure]:
    """Draw Fig. 11, the scatter by source, and its dependence on the size of the sources."""
    return {
        "Energy of the same gait in each run over the mean of its model, all sources together, as in Fig. 11; right: "
        "its distribution.": _runs(result),
        "Standard deviation by source, with 95 % intervals; dotted: the paper's figures.": _sources(result),
        "Standard deviation against the size of all sources together (1: as in the settings). A proportional curve "
        "reflects the sources, a level one the simulation itself. Dotted: the paper's figures.": _sizes(result),
    }


def _runs(result: EnergyResult) -> Figure:
    figure, panels = subplots(10.0, 5.0, 2, 2, sharey="row", sharex="col", width_ratios=(3, 1))
    for row, integrator in zip(panels, (EXPLICIT, IMPLICIT)):
        for gearbox in PAPER:
            model = (gearbox, integrator)
            energy = result.energies[model][ALL].sum(axis=1)
            off = 100.0 * (energy / np.nanmean(energy) - 1.0)
            style = {"color": COLORS[gearbox, EXPLICIT]}
            label = f"{_name(model)}: {_percent(result.scatter(model).value)}"
            marker = "o" if gearbox == "standard" else "s"
            row[0].plot(np.arange(1, len(off) + 1), off, marker, ms=3, label=label, **style)
            row[1].hist(off[np.isfinite(off)], bins=15, orientation="horizontal", alpha=0.6, **style)
        row[0].set_ylabel("energy less mean [%]")
        row[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, borderaxespad=0.2)
    panels[1, 0].set_xlabel("run")
    panels[1, 1].set_xlabel("number of runs")
    return figure


def _sources(result: EnergyResult) -> Figure:
    figure, axes = subplots(9.0, 3.8)
    names = [*SOURCES, ALL]
    for k, model in enumerate(MODELS):
        scatters = [result.scatter(model, name) for name in names]
        values = np.array([s.value for s in scatters])
        error = np.abs(np.array([[s.low, s.high] for s in scatters]).T - values)
        places = np.arange(len(names)) + 0.2 * (k - 1.5)
        style: dict[str, Any] = {"marker": "o", "linestyle": "", "capsize": 3, "color": COLORS[model]}
        axes.errorbar(places, 100 * values, 100 * error, label=_name(model), **style)
    _papers(axes)
    axes.set_xticks(range(len(names)), names)
    axes.set(ylabel="standard deviation of the energy [%]", yscale="log")
    figure.legend(loc="outside upper center", ncols=4)
    return figure


def _sizes(result: EnergyResult) -> Figure:
    figure, axes = subplots(7.0, 4.0)
    scales = sorted((*result.settings.scales, 1.0))
    for model in MODELS:
        scatters = [result.scatter(model, ALL if scale == 1.0 else (ALL, scale)) for scale in scales]
        values = np.array([s.value for s in scatters])
        error = np.abs(np.array([[s.low, s.high] for s in scatters]).T - values)
        style: dict[str, Any] = {"marker": "o", "capsize": 2, "color": COLORS[model], "label": _name(model)}
        axes.errorbar(scales, 100 * values, 100 * error, **style)
    _papers(axes)
    axes.set(xlabel="size of the sources [times the settings]", ylabel="standard deviation of the energy [%]")
    axes.set(xscale="log", yscale="log")
    figure.legend(loc="outside upper center", ncols=4, fontsize=8)
    return figure


def _papers(axes: Axes) -> None:
    """Draw the paper's scatter of both models."""
    for gearbox, value in PAPER.items():
        color, text = COLORS[gearbox, EXPLICIT], f"paper {100 * value:g} %"
        axes.axhline(100 * value, color=color, linestyle=":", linewidth=1.2)
        axes.annotate(text, (0.01, 100 * value), xycoords=axes.get_yaxis_transform(), xytext=(0, 2),
                      textcoords="offset points", color=color, fontsize=7.5, va="bottom")  # fmt: skip
