"""A static problem and the path that loads it, step by step, through limit points.

The path takes each `LoadStep` in adaptive increments of its own pseudo-time. Newton's method
with a line search solves an increment; where none converges above the smallest increment, the
load is held and the body creeps to the next equilibrium in a viscous bath that is drained to
nothing (a damped path, also called stabilisation), which carries the solution past limit points
where no neighbouring equilibrium exists.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from flexapod.core.errors import InputError, SolverError, Status
from flexapod.fem.body import SolidBody
from flexapod.fem.contacts import Contact
from flexapod.fem.loads import Conditions, Displacement, Load
from flexapod.fem.newton import (
    CreepOptions,
    NewtonOptions,
    NewtonReport,
    creep,
    land,
    newton,
)
from flexapod.fem.sparse import BlockPattern, DirectSolver


@dataclass(frozen=True)
class LoadStep:
    """One stage of loading: every named factor runs linearly to its value at the step's end.

    Attributes
    ----------
    name
        For messages and files.
    factors
        Load name to the factor reached at the end; loads not named keep theirs.
    outputs
        Number of equal parts after each of which a state is kept.
    first, smallest, largest
        Increments of the step's time (0 to 1).
    """

    name: str
    factors: Mapping[str, float]
    outputs: int = 1
    first: float = 0.1
    smallest: float = 1.5e-2
    largest: float = 1.0

    def __post_init__(self) -> None:
        if self.outputs < 1:
            raise InputError(f"outputs must be >= 1, got {self.outputs}", f"step {self.name}")
        if not 0.0 < self.smallest <= self.first <= 1.0:
            raise InputError(
                f"increments must obey 0 < smallest <= first <= 1, got {self.smallest:g} and "
                f"{self.first:g}",
                f"step {self.name}",
            )


@dataclass(frozen=True)
class PathOptions:
    """How the path walks."""

    newton: NewtonOptions = field(default_factory=NewtonOptions)
    max_increments: int = 2000
    growth: float = 1.6  # of the increment after an easy solution
    cut: float = 0.35  # of the increment after a failure
    easy_iterations: int = 9  # at most this many iterations count as easy
    damped: bool = True  # creep past limit points in a viscous bath
    creep: CreepOptions = field(default_factory=CreepOptions)


@dataclass
class PathState:
    """Everything that moves along the path; enough to go on from."""

    u: np.ndarray  # displacements [m], shape (node_count, 3)
    step: int = 0  # index of the step under way
    time: float = 0.0  # within that step, 0 to 1
    factors: dict[str, float] = field(default_factory=dict)
    increment: float | None = None
    velocity: np.ndarray | None = None  # du per step time of the last increment, the predictor
    bend: np.ndarray | None = None  # second divided difference of u over the last two
    last_size: float = 0.0  # of the last increment
    history: list[np.ndarray] = field(default_factory=list)  # of each contact
    damped_work: float = 0.0  # dissipated in the viscous bath [J]


@dataclass(frozen=True)
class Increment:
    """One accepted equilibrium, handed to `on_increment`."""

    state: PathState
    step_name: str
    is_output: bool
    report: NewtonReport
    damped: bool


@dataclass
class PathStats:
    """What the path cost."""

    increments: int = 0
    iterations: int = 0
    cutbacks: int = 0
    damped_increments: int = 0
    wall_time: float = 0.0
    pattern_builds: int = 0


class StaticProblem:
    """Body, conditions, loads and contacts; residual and tangent for Newton's method.

    Parameters
    ----------
    body
        The soft body.
    displacements
        Supports and prescribed displacements.
    loads
        Named loads.
    contacts
        Contacts; their forces have no factor.
    """

    def __init__(
        self,
        body: SolidBody,
        displacements: Sequence[Displacement],
        loads: Sequence[Load],
        contacts: Sequence[Contact] = (),
    ) -> None:
        self.body = body
        self.conditions = Conditions(body.node_count, displacements)
        self.loads = list(loads)
        self.contacts = list(contacts)
        names = [load.name for load in self.loads]
        if len(set(names)) < len(names):
            raise InputError(f"two loads share a name: {sorted(names)}")
        self.load_names = sorted({*names, *self.conditions.names})
        self.scale = {load.name: load.scale(body.nodes) for load in self.loads}
        self.pattern: BlockPattern | None = None
        self.pattern_builds = 0
        self.pressure: np.ndarray | None = None  # of the tangent's geometric part [Pa]

    def positions(self, u: np.ndarray) -> np.ndarray:
        """Current node positions [m]."""
        return np.asarray(self.body.nodes + u)

    def search(self, u: np.ndarray) -> None:
        """Let every contact look again for what may touch."""
        x = self.positions(u)
        for contact in self.contacts:
            contact.update(x)

    def freeze(self, frozen: bool) -> None:
        """Let contact points keep the partner faces they have, or choose anew again.

        A point that balances on the edge of two faces changes sides for ever; on either face
        it is in balance.
        """
        for contact in self.contacts:
            contact.freeze(frozen)

    def residual(self, u: np.ndarray, factors: Mapping[str, float]) -> tuple[np.ndarray, float]:
        """Return internal minus external force [N] (node_count, 3) and the stored energy [J].

        The energy (strain and contact) is infinite where an element is inside out.
        """
        out = np.empty_like(u)
        energy = self.body.internal_force(u, out)
        if not np.isfinite(energy):
            return out, np.inf
        x = self.positions(u)
        for load in self.loads:
            load.add_residual(x, factors.get(load.name, 0.0), out)
        for contact in self.contacts:
            energy += contact.add_residual(x, out)
        return out, energy

    def reactions(self, u: np.ndarray, factors: Mapping[str, float]) -> np.ndarray:
        """Forces the conditions exert on the body [N], shape (node_count, 3)."""
        out, _ = self.residual(u, factors)
        return np.where(self.conditions.fixed, out, 0.0)

    def tangent(self, u: np.ndarray, factors: Mapping[str, float]) -> BlockPattern:
        """Assemble the tangent at `u` into the pattern, which grows only when contact asks."""
        x = self.positions(u)
        items = [s for load in self.loads if (s := load.stiffness(x, factors.get(load.name, 0.0)))]
        for contact in self.contacts:
            items.extend(contact.stiffness(x))
        if self.pattern is None:
            self._build_pattern()
        assert self.pattern is not None
        self._gather(u)
        if sum(self.pattern.add(nodes, matrix) for nodes, matrix in items):
            self.search(u)
            self._build_pattern([nodes for nodes, _ in items])
            self._gather(u)
            for nodes, matrix in items:
                self.pattern.add(nodes, matrix)
        return self.pattern

    def _build_pattern(self, items: Sequence[np.ndarray] = ()) -> None:
        extra = [nodes for nodes in items if nodes.shape[0]]
        extra += [c for contact in self.contacts for c in contact.couplings() if c.shape[0]]
        extra += [load.faces for load in self.loads if hasattr(load, "faces")]
        self.pattern = BlockPattern(self.body.cells, self.body.node_count, tuple(extra))
        self.pattern_builds += 1

    def _gather(self, u: np.ndarray) -> None:
        assert self.pattern is not None
        pressure = self.pressure
        if pressure is None:
            pressure = self.body.predict_pressure(u, np.zeros_like(u))
        self.pattern.gather(self.body, self.body.element_tangents(u, pressure))

    def predict_pressure(self, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """The pressure [Pa] linearised along a correction; see `SolidBody.predict_pressure`."""
        return self.body.predict_pressure(u, du)

    def pressure_error_force(self, u: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """What turns the residual into the mixed form's; see `SolidBody.pressure_error_force`."""
        return self.body.pressure_error_force(u, pressure)

    def force_scale(self, factors: Mapping[str, float], residual: np.ndarray) -> float:
        """The force [N] residuals are compared with: the largest load or reaction at a node."""
        scale = max((abs(factors.get(n, 0.0)) * s for n, s in self.scale.items()), default=0.0)
        fixed = self.conditions.fixed
        if fixed.any():
            scale = max(scale, float(np.abs(residual[fixed]).max()))
        return scale

    def commit(self) -> None:
        """Accept the contacts' trial histories."""
        for contact in self.contacts:
            contact.commit()

    def save_history(self) -> list[np.ndarray]:
        """Copies of the contacts' committed histories."""
        return [np.array(getattr(c, "anchor", np.empty(0))) for c in self.contacts]

    def restore_history(self, history: Sequence[np.ndarray]) -> None:
        """Put committed histories back."""
        for contact, anchor in zip(self.contacts, history, strict=False):
            if anchor.size:
                contact.anchor[:] = anchor  # type: ignore[attr-defined]


@dataclass(frozen=True)
class StaticResult:
    """How the path ended; the states themselves went to `on_increment`."""

    status: Status
    message: str
    state: PathState
    stats: PathStats


def solve_path(
    problem: StaticProblem,
    steps: Sequence[LoadStep],
    options: PathOptions | None = None,
    on_increment: Callable[[Increment], None] | None = None,
    start: PathState | None = None,
    on_message: Callable[[str], None] | None = None,
) -> StaticResult:
    """Walk through all steps; failures end the path with a status, they are not raised.

    Parameters
    ----------
    problem
        What is solved.
    steps
        The stages of loading, in order.
    options
        Increment control and Newton's options.
    on_increment
        Called with each accepted equilibrium (arrays must be copied to be kept).
    start
        A state to go on from (resume); the default is the undeformed body.
    on_message
        Called with one line about each cut-back or damped stage.

    Raises
    ------
    InputError
        A step names a load that does not exist.
    """
    options = options or PathOptions()
    for step in steps:
        unknown = set(step.factors) - set(problem.load_names)
        if unknown:
            raise InputError(
                f"unknown load {sorted(unknown)}; the problem has {problem.load_names}",
                f"step {step.name}",
            )
    return _Path(problem, steps, options, on_increment, start, on_message).run()


class _Path:
    def __init__(
        self,
        problem: StaticProblem,
        steps: Sequence[LoadStep],
        options: PathOptions,
        on_increment: Callable[[Increment], None] | None,
        start: PathState | None,
        on_message: Callable[[str], None] | None,
    ) -> None:
        self.problem = problem
        self.steps = steps
        self.options = options
        self.on_increment = on_increment or (lambda increment: None)
        self.say = on_message or (lambda text: None)
        self.state = start or PathState(
            u=np.zeros((problem.body.node_count, 3)),
            factors={name: 0.0 for name in problem.load_names},
        )
        if self.state.history:
            problem.restore_history(self.state.history)
        self.solver = DirectSolver()
        self.stats = PathStats()
        self.body_size = float(np.ptp(problem.body.nodes, axis=0).max())

    def run(self) -> StaticResult:
        began = time.perf_counter()
        status, message = Status.DONE, Status.DONE.value
        try:
            while self.state.step < len(self.steps):
                self._step(self.steps[self.state.step])
        except SolverError as error:
            status, message = error.status, str(error)
        except KeyboardInterrupt:
            status, message = Status.INTERRUPTED, f"stopped at {self._place()}"
        finally:
            self.solver.close()
        self.stats.wall_time = time.perf_counter() - began
        self.stats.pattern_builds = self.problem.pattern_builds
        return StaticResult(status, message, self.state, self.stats)

    def _place(self) -> str:
        loads = ", ".join(f"{k} {v:.4g}" for k, v in self.state.factors.items())
        step = self.steps[min(self.state.step, len(self.steps) - 1)].name
        return f"step {step!r} at {self.state.time:.4f} of it (load factors: {loads})"

    def _step(self, step: LoadStep) -> None:
        state = self.state
        begin = self._begin_factors(step)
        increment = state.increment or step.first
        while state.time < 1.0 - 1e-9:
            if self.stats.increments >= self.options.max_increments:
                raise SolverError(Status.TOO_MANY_INCREMENTS, f"stopped at {self._place()}")
            next_output = (np.floor(state.time * step.outputs + 1e-9) + 1.0) / step.outputs
            increment = min(increment, step.largest)
            reach = min(state.time + increment, next_output)
            # Avoid a sliver of an increment just before an output.
            if next_output - reach < 0.2 * increment and next_output - state.time <= step.largest:
                reach = next_output
            size = reach - state.time
            target = self._target(step, begin, reach)
            u, report, failure = self._solve(target, size)
            damped = False
            if failure is not None:
                self.stats.cutbacks += 1
                if size * self.options.cut >= step.smallest:
                    increment = size * self.options.cut
                    self.say(f"{failure.name.lower()}: increment cut to {increment:.4f}")
                    continue
                if not self.options.damped:
                    raise SolverError(
                        Status.STEP_TOO_SMALL, f"stopped at {self._place()}: {failure.value}"
                    )
                # Where small increments fail, the body is about to jump or contact to change at
                # many places at once: creep all the way to the next output instead.
                self.say(f"{failure.name.lower()}: damped path at {self._place()}")
                reach = next_output
                size = reach - state.time
                target = self._target(step, begin, reach)
                u, report = self._creep(target, failure)
                damped = True
                self.stats.damped_increments += 1
            # The very first increment closes gaps and seats the body: no guide to the next one.
            seated = state.time > 0.0 and not damped
            velocity = (u - state.u) / size if seated else None
            state.bend = (
                (velocity - state.velocity) / (size + state.last_size)
                if velocity is not None and state.velocity is not None
                else None
            )
            state.velocity = velocity
            state.last_size = float(size)
            state.u = u
            state.time = float(reach)
            state.factors = target
            self.problem.residual(u, target)
            self.problem.commit()
            state.history = self.problem.save_history()
            self.stats.increments += 1
            if damped:
                increment = max(step.smallest, step.first)
            elif report.iterations <= self.options.easy_iterations:
                increment = max(increment, size) * self.options.growth
            elif report.iterations > 2 * self.options.easy_iterations:
                increment = 0.7 * size
            state.increment = float(increment)
            is_output = abs(state.time - next_output) < 1e-9
            last = state.time >= 1.0 - 1e-9
            if last:
                state.step += 1
                state.time = 0.0
                state.increment = None
                state.velocity = None
                state.bend = None
            self.on_increment(Increment(state, step.name, is_output, report, damped))
            if last:
                return

    def _target(self, step: LoadStep, begin: dict[str, float], reach: float) -> dict[str, float]:
        """Factors at the time `reach` of a step."""
        moving = {k: begin[k] + reach * (v - begin[k]) for k, v in step.factors.items()}
        return {**self.state.factors, **moving}

    def _begin_factors(self, step: LoadStep) -> dict[str, float]:
        """Factors at the step's start, also when it is resumed half way."""
        t = self.state.time
        return {k: (self.state.factors[k] - t * v) / (1.0 - t) for k, v in step.factors.items()}

    def _solve(
        self, target: dict[str, float], size: float
    ) -> tuple[np.ndarray, NewtonReport, Status | None]:
        """One increment by Newton: with the extrapolated start first, then from rest."""
        state = self.state
        if state.velocity is not None:
            guess = state.u + size * state.velocity
            # Curved extrapolation pays while the body rotates, but not far beyond what it saw.
            if state.bend is not None and size < 2.0 * state.last_size:
                guess += size * (size + state.last_size) * state.bend
            self.problem.conditions.apply(guess, target)
            if np.isfinite(self.problem.residual(guess, target)[1]):
                return self._newton(guess, target)
        return self._newton(state.u.copy(), target)

    def _newton(
        self,
        guess: np.ndarray,
        target: dict[str, float],
    ) -> tuple[np.ndarray, NewtonReport, Status | None]:
        pressure = self.problem.pressure
        u, report, failure = newton(
            self.problem, self.solver, guess, target, self.options.newton, self.body_size
        )
        self.stats.iterations += report.iterations
        if failure is Status.NOT_CONVERGED and report.residual < self.options.newton.near:
            landed = land(self.problem, self.solver, u, target, self.options.newton, self.body_size)
            if landed is not None:
                self.stats.iterations += landed[1].iterations
                return *landed, None
        if failure is not None:
            self.problem.pressure = pressure
        return u, report, failure

    def _creep(self, target: dict[str, float], failure: Status) -> tuple[np.ndarray, NewtonReport]:
        """Hold the load and let the body creep to equilibrium in a thinning viscous bath."""
        body = self.problem.body
        soft = min(m.law.shear_modulus for m in body.materials)
        # At strength one, the bath is as stiff as the softest material over a cell's width.
        width = np.cbrt(body.cell_volume.mean())
        u, report, work, bad = creep(
            self.problem,
            self.solver,
            self.state.u,
            target,
            self.options.newton,
            self.options.creep,
            self.body_size,
            soft / width**2 * body.node_volume,
            self.say,
        )
        self.stats.iterations += report.iterations
        self.state.damped_work += work
        if bad is None:
            return u, report
        raise SolverError(
            Status.STEP_TOO_SMALL,
            f"stopped at {self._place()}: {failure.value}, and the damped path found no "
            f"equilibrium either ({bad.value})",
        )
