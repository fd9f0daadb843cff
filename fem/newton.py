"""Newton's method with a line search: residual and tangent in, root and status out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
    max_iterations
        After which the increment has failed.
    divergence
        Growth of the residual over the first one that ends the attempt early.
    patience
        Iterations without a residual a tenth smaller than the best one that end it too.
    line_search_steps
        Halvings at most of one correction.
    """

    residual_tolerance: float = 1e-4
    increment_tolerance: float = 1e-5
    max_iterations: int = 20
    divergence: float = 1e4
    patience: int = 10
    line_search_steps: int = 5


@dataclass(frozen=True)
class NewtonReport:
    """What one solution took."""

    iterations: int
    residual: float  # largest free nodal residual over the force scale
    residuals: tuple[float, ...]  # of every iteration, for the order of convergence
    negative_pivots: int  # of the last factorisation: > 0 means an unstable equilibrium


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


def newton(
    problem: Equations,
    solver: DirectSolver,
    guess: np.ndarray,
    factors: Mapping[str, float],
    options: NewtonOptions,
    body_size: float,
    damping: np.ndarray | None = None,
    anchor: np.ndarray | None = None,
) -> tuple[np.ndarray, NewtonReport, Status | None]:
    """Solve for equilibrium at fixed load factors from `guess`.

    `damping` [N/m] per node pulls every node to `anchor` (the damped path). Returns the last
    displacements, a report and None, or the reason of failure.

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

    def evaluate(v: np.ndarray) -> tuple[np.ndarray, float]:
        r, energy = problem.residual(v, factors)
        if damping is not None:
            r += damping[:, None] * (v - anchor)
        return r, energy

    def report(count: int) -> NewtonReport:
        last = residuals[-1] if residuals else np.inf
        return NewtonReport(count, last, tuple(residuals), solver.negative_pivots)

    r, energy = evaluate(u)
    if not np.isfinite(energy):
        # Moving supports alone can flip the elements next to them: the caller cuts back.
        return u, report(0), Status.INVERTED_ELEMENT
    correction = np.inf
    best, stale = np.inf, 0
    for iteration in range(options.max_iterations + 1):
        scale = max(problem.force_scale(factors, r), 1e-12)
        error = float(np.abs(r[free]).max(initial=0.0)) / scale
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
        if damping is not None:
            pattern.add_diagonal(damping)
        rhs = np.where(fixed, 0.0, -r)
        try:
            solver.factorise(pattern.matrix(flat_fixed), pattern)
        except SolverError as error_:
            return u, report(iteration), error_.status
        du = solver.solve(rhs.ravel()).reshape(u.shape)
        if not np.isfinite(du).all():
            return u, report(iteration), Status.SINGULAR
        old = problem.pressure
        if old is None:
            old = problem.predict_pressure(u, np.zeros_like(u))
        new = problem.predict_pressure(u, du)
        slope = float((du * (r + problem.pressure_error_force(u, old)))[free].sum())
        length = 1.0
        for trial in range(options.line_search_steps + 1):
            candidate = u + length * du
            r_new, energy = evaluate(candidate)
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
