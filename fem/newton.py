"""Newton's method with a line search: residual and tangent in, root and status out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from flexapod.core.errors import SolverError, Status
from flexapod.fem.loads import Conditions
from flexapod.fem.sparse import BlockPattern, DirectSolver


@dataclass(frozen=True)
class NewtonOptions:
    """When an equilibrium is reached and when to give up.

    Attributes
    ----------
    residual_tolerance
        Largest free nodal residual over the force scale (largest nodal load or reaction).
    increment_tolerance
        Largest correction of a node over the body's size.
    near
        Largest residual over the force scale at which a solution whose contact points flicker
        may land with their partners held.
    flicker
        Largest residual over the force scale that may be left once the partners of a landed
        solution are free again: the jump of a single point's force as it changes faces.
    close
        Correction of a node over the body's size that is none where the residual is `near`: a
        point of friction or contact that Newton's method steps over and over keeps it up.
    landings
        How often at most the partners are held, the solution found and the partners freed.
    max_iterations
        After which the increment has failed.
    divergence
        Growth of the residual over the first one that ends the attempt early.
    patience
        Iterations without a residual a tenth smaller than the best one that end it too.
    line_search_steps
        Halvings at most of one correction.
    """

    residual_tolerance: float = 1e-3
    increment_tolerance: float = 1e-5
    near: float = 2e-2
    flicker: float = 0.1
    close: float = 1e-3
    landings: int = 6
    max_iterations: int = 16
    divergence: float = 1e4
    patience: int = 7
    line_search_steps: int = 5


@dataclass(frozen=True)
class CreepOptions:
    """How the damped path walks to the next stable equilibrium.

    Attributes
    ----------
    first
        Strength of the bath at the start; at one it is as stiff as the softest material.
    thin
        Strength below which the bath no longer shows.
    thickest
        Strength at which the path gives up.
    max_steps
        After which the path has failed.
    largest_move
        Of a node in one step over the body's size: a step that moves far may carry one wall
        through another unseen.
    search_after
        Move of a node over the body's size after which contact searches again.
    """

    first: float = 1e-2
    thin: float = 1e-4
    thickest: float = 1e4
    max_steps: int = 400
    largest_move: float = 0.02
    search_after: float = 2e-3


@dataclass(frozen=True)
class NewtonReport:
    """What one solution took."""

    iterations: int
    residual: float  # largest free nodal residual over the force scale
    residuals: tuple[float, ...]  # of every iteration, for the order of convergence
    negative_pivots: int  # of the last factorisation: > 0 means an unstable equilibrium
    correction: float = np.inf  # the last one's largest move of a node, before any line search [m]


class Equations(Protocol):
    """What Newton's method asks of a problem."""

    conditions: Conditions

    def residual(self, u: np.ndarray, factors: Mapping[str, float]) -> tuple[np.ndarray, float]:
        """Residual [N] and energy [J]."""
        ...

    def tangent(self, u: np.ndarray, factors: Mapping[str, float]) -> BlockPattern:
        """Tangent in block form."""
        ...

    def force_scale(self, factors: Mapping[str, float], residual: np.ndarray) -> float:
        """Force the residual is compared with [N]."""
        ...

    pressure: np.ndarray | None

    def predict_pressure(self, u: np.ndarray, du: np.ndarray) -> np.ndarray:
        """Geometric pressure of the next tangent [Pa]."""
        ...

    def pressure_error_force(self, u: np.ndarray, pressure: np.ndarray) -> np.ndarray:
        """What turns the residual into the mixed form's [N]."""
        ...

    def search(self, u: np.ndarray) -> None:
        """Refresh contact candidates."""
        ...

    def freeze(self, frozen: bool) -> None:
        """Hold the partners of contact points, or free them."""
        ...


def _imbalance(problem: Equations, r: np.ndarray, factors: Mapping[str, float]) -> float:
    """Largest free nodal residual over the force scale."""
    largest = float(np.abs(r[~problem.conditions.fixed]).max(initial=0.0))
    return largest / max(problem.force_scale(factors, r), 1e-12)


def _pressures(problem: Equations, u: np.ndarray, du: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Geometric pressure [Pa] before and after a whole correction."""
    old = problem.pressure
    if old is None:
        old = problem.predict_pressure(u, np.zeros_like(u))
    return old, problem.predict_pressure(u, du)


def newton(
    problem: Equations,
    solver: DirectSolver,
    guess: np.ndarray,
    factors: Mapping[str, float],
    options: NewtonOptions,
    body_size: float,
) -> tuple[np.ndarray, NewtonReport, Status | None]:
    """Solve for equilibrium at fixed load factors from `guess`.

    Returns the last displacements, a report and None, or the reason of failure.

    The line search works on the slope along the correction, ``du . R``, with the residual of
    the mixed form (its pressure taken linearly along the step, so that the second-order change
    of volume of a step does not count as an error): a step is halved while it turns an element
    inside out, and cut to the root of the slope's straight line while the slope stays large.
    """
    fixed = problem.conditions.fixed
    free = ~fixed
    flat_fixed = fixed.ravel()
    u = guess.copy()
    problem.conditions.apply(u, dict(factors))
    problem.search(u)
    residuals: list[float] = []
    full = np.inf

    def report(count: int) -> NewtonReport:
        last = residuals[-1] if residuals else np.inf
        return NewtonReport(count, last, tuple(residuals), solver.negative_pivots, full)

    r, energy = problem.residual(u, factors)
    if not np.isfinite(energy):
        # Moving supports alone can flip the elements next to them: the caller cuts back.
        return u, report(0), Status.INVERTED_ELEMENT
    correction = np.inf
    best, stale = np.inf, 0
    for iteration in range(options.max_iterations + 1):
        error = _imbalance(problem, r, factors)
        residuals.append(error)
        if not np.isfinite(error):
            return u, report(iteration), Status.NOT_FINITE
        if iteration > 3 and error > options.divergence * residuals[0]:
            return u, report(iteration), Status.NOT_CONVERGED
        if error < 0.9 * best:
            best, stale = error, 0
        else:
            stale += 1
        if stale > options.patience:
            return u, report(iteration), Status.NOT_CONVERGED
        small = correction < options.increment_tolerance * body_size
        if error < options.residual_tolerance and (small or error < 1e-8):
            return u, report(iteration), None
        if iteration == options.max_iterations:
            break
        pattern = problem.tangent(u, factors)
        rhs = np.where(fixed, 0.0, -r)
        try:
            solver.factorise(pattern.matrix(flat_fixed), pattern)
        except SolverError as error_:
            return u, report(iteration), error_.status
        du = solver.solve(rhs.ravel()).reshape(u.shape)
        if not np.isfinite(du).all():
            return u, report(iteration), Status.SINGULAR
        full = float(np.abs(du).max())
        old, new = _pressures(problem, u, du)
        slope = float((du * (r + problem.pressure_error_force(u, old)))[free].sum())
        length = 1.0
        for trial in range(options.line_search_steps + 1):
            candidate = u + length * du
            r_new, energy = problem.residual(candidate, factors)
            if not np.isfinite(energy):
                if trial == options.line_search_steps:
                    return u, report(iteration), Status.INVERTED_ELEMENT
                length *= 0.5
                continue
            pressure = old + length * (new - old)
            mixed = r_new + problem.pressure_error_force(candidate, pressure)
            new_slope = float((du * mixed)[free].sum())
            if abs(new_slope) <= 0.8 * abs(slope) or trial == options.line_search_steps:
                break
            # The root of the straight line through both slopes, kept within a sane part.
            ratio = slope / (slope - new_slope) if slope != new_slope else 0.5
            length *= min(max(ratio, 0.15), 0.6) if ratio > 0.0 else 0.5
        problem.pressure = pressure
        u = candidate
        r = r_new
        correction = length * float(np.abs(du).max())
    return u, report(options.max_iterations), Status.NOT_CONVERGED


def land(
    problem: Equations,
    solver: DirectSolver,
    start: np.ndarray,
    factors: Mapping[str, float],
    options: NewtonOptions,
    body_size: float,
) -> tuple[np.ndarray, NewtonReport] | None:
    """Newton's method from near balance with the contact points' partners held.

    Returns a stable solution that is still near balance with the partners free, or None.
    """
    pressure = problem.pressure
    brief = replace(options, max_iterations=12, patience=5)
    u, count = start, 0
    for _ in range(options.landings):
        problem.search(u)
        problem.residual(u, factors)
        problem.freeze(True)
        try:
            u, report, bad = newton(problem, solver, u, factors, brief, body_size)
        finally:
            problem.freeze(False)
        count += report.iterations
        close = report.residual < options.near and report.correction < options.close * body_size
        if report.negative_pivots > 0 or not (bad is None or close):
            break
        problem.search(u)
        r, _ = problem.residual(u, factors)
        error = _imbalance(problem, r, factors)
        if error < options.flicker:
            return u, replace(report, residual=error, iterations=count)
    problem.pressure = pressure
    return None


def creep(
    problem: Equations,
    solver: DirectSolver,
    start: np.ndarray,
    factors: Mapping[str, float],
    options: NewtonOptions,
    creeping: CreepOptions,
    body_size: float,
    bath: np.ndarray,
    say: Callable[[str], None],
) -> tuple[np.ndarray, NewtonReport, float, Status | None]:
    """Let the body creep to a stable equilibrium at held loads, in a bath as thick as it needs.

    One linearly implicit step of ``bath u' = -residual`` after another (pseudo-transient
    continuation; Kelley & Keyes 1998, doi:10.1137/S0036142996304796). The bath thickens until
    the matrix is positive definite, so that every step leads down, away from saddle points, and
    thins with the residual, so that the last steps are Newton's. Unlike Newton's method it
    needs no balance on the way: a wall that buckles or touches takes more steps, that is all.

    Parameters
    ----------
    bath
        Nodal stiffness [N/m] of a bath of strength one, shape (node_count,).

    Returns
    -------
    Displacements, report, work spent in the bath [J] and None or the reason of failure.
    """
    free = ~problem.conditions.fixed
    flat_fixed = problem.conditions.fixed.ravel()
    u = start.copy()
    problem.conditions.apply(u, dict(factors))
    problem.search(u)
    strength, work = creeping.first, 0.0
    residuals: list[float] = []
    status = Status.NOT_CONVERGED
    cap = creeping.largest_move * body_size
    r, energy = problem.residual(u, factors)
    if not np.isfinite(energy):
        return u, NewtonReport(0, np.inf, (), 0), work, Status.INVERTED_ELEMENT
    settled = False
    unstable, firm_until, landing = 0.0, 0, 3
    for count in range(creeping.max_steps):
        error = _imbalance(problem, r, factors)
        norm = float(np.linalg.norm(r[free]))
        residuals.append(error)
        if settled and error < options.residual_tolerance and strength < creeping.thin:
            report = NewtonReport(count, error, tuple(residuals), solver.negative_pivots)
            return u, report, work, None
        if error < options.near and count >= landing:
            landing = count + 8
            landed = land(problem, solver, u, factors, options, body_size)
            if landed is not None:
                v, report = landed
                return v, replace(report, iterations=count + report.iterations), work, None
            r, _ = problem.residual(u, factors)
        pattern = problem.tangent(u, factors)
        rhs = np.where(problem.conditions.fixed, 0.0, -r).ravel()
        added = 0.0
        try:
            while True:
                pattern.add_diagonal((strength - added) * bath)
                added = strength
                solver.factorise(pattern.matrix(flat_fixed), pattern)
                if solver.negative_pivots == 0:
                    break
                if strength > creeping.thickest:
                    return u, NewtonReport(count, error, tuple(residuals), 1), work, status
                unstable, firm_until = strength, count + 4
                strength = max(4.0 * strength, 1e-4)
        except SolverError as error_:
            return u, NewtonReport(count, error, tuple(residuals), 0), work, error_.status
        du = solver.solve(rhs).reshape(u.shape)
        old, new = _pressures(problem, u, du)
        size = float(np.abs(du).max())
        slope = float((du * (r + problem.pressure_error_force(u, old)))[free].sum())
        length = min(1.0, cap / size)
        capped = length < 1.0
        for trial in range(8):
            candidate = u + length * du
            r_new, energy = problem.residual(candidate, factors)
            if np.isfinite(energy):
                pressure = old + length * (new - old)
                mixed = r_new + problem.pressure_error_force(candidate, pressure)
                new_slope = float((du * mixed)[free].sum())
                if new_slope < -0.5 * slope or trial == 7:
                    break
            elif trial == 7:
                status = Status.INVERTED_ELEMENT
                break
            length *= 0.5
        if not np.isfinite(energy):
            strength = max(8.0 * strength, 1e-3)
            if strength > creeping.thickest:
                return u, NewtonReport(count, error, tuple(residuals), 0), work, status
            continue
        step = length * du
        work += float((strength * bath[:, None] * step * step).sum())
        u, r, problem.pressure = candidate, r_new, pressure
        moved = length * size
        if moved > creeping.search_after * body_size:
            problem.search(u)
            r, _ = problem.residual(u, factors)
        ratio = float(np.linalg.norm(r[free])) / max(norm, 1e-300)
        settled = moved < options.increment_tolerance * body_size
        before = strength
        if trial > 0:
            strength *= 2.0
        elif not capped:
            # Thin the bath with the residual, and also where the step hardly changed the slope
            # it went down: it was the bath that stopped it.
            thinner = min(max(ratio, 0.2), 2.0 if ratio > 1.2 else 1.0)
            strength *= min(thinner, 0.4) if new_slope < 0.6 * slope else thinner
        if count < firm_until:
            strength = max(strength, 1.5 * unstable)
        strength = min(max(strength, 0.01 * creeping.thin), creeping.thickest)
        if count % 5 == 0:
            say(
                f"creep {count}: bath {before:.1e}, residual {error:.1e}, move {moved * 1e3:.3f} mm"
            )
    report = NewtonReport(creeping.max_steps, residuals[-1], tuple(residuals), 0)
    return u, report, work, status
