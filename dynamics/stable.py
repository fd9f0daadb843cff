"""The stable step: bounds of the highest frequency of elements, lines, contacts and joints."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from flexapod.core.errors import SolverError, Status
from flexapod.dynamics import kernels
from flexapod.dynamics.contacts import RATE_MARGIN, rate_margin
from flexapod.dynamics.model import Model, State
from flexapod.dynamics.workspace import Workspace
from flexapod.fem import kernels as fem_kernels

# Contact (or bonds) shortens the step where the frequency is so many times that of elements or
# joints alone.
TOUCHED = 1.1


def highest_frequency(model: Model, state: State, work: Workspace, anew: bool = True) -> float:
    """Upper bound of the highest angular frequency at the current state [rad/s].

    Per element from its current tangent, and from the springs and dashpots of contacts, bonds,
    lines and joints its nodes are in. A step of central differences whose damping forces are half
    a step old is stable where ``dt**2 k / 4 + dt c / 2 <= 1`` (k of the squared frequencies, c of
    the decay rates): the frequency returned is the one of an undamped system with the same largest
    step.

    Without `anew` the elements' part is that of the last time; only the rest is looked at, which
    is cheap.
    """
    work.springs[:] = 0.0
    work.dashpots[:] = 0.0
    work.margins = _margins(model, state)
    rows = zip(model.contacts, state.histories, work.margins, strict=True)
    for contact, history, margin in rows:
        contact.add_rates(history, work.inverse_mass, margin, work.springs, work.dashpots)
    for bond, whole in zip(model.bonds, state.whole, strict=True):
        if whole:
            for side in range(2):
                nodes = bond.pairs[:, side]
                part = 2.0 * bond.stiffness * work.inverse_mass[nodes]
                np.add.at(work.springs, nodes, part)
                np.add.at(work.dashpots, nodes, bond.damping * part)
    if model.lines is not None:
        model.lines.add_rates(
            model.nodes, state.lines, work.inverse_mass, work.springs, work.dashpots
        )
    _gather_owned(model, work)
    square = alone = 0.0
    if work.joint_rates is not None:
        # The bodies they hold may be in elements and in contact too: bounds of sums add up.
        spring, dashpot = work.joint_rates
        owner = model.owner[model.owned]
        work.springs[model.owned] += spring[owner]
        work.dashpots[model.owned] += dashpot[owner]
        square = alone = float(_squared(spring, dashpot).max())  # bodies without nodes count too
    square = max(square, float(_squared(work.springs, work.dashpots).max(initial=0.0)))
    if model.internal is not None:
        if anew:
            _estimate_elements(model, state, work)
            kernels.worst_at_nodes(work.elements, model.cells, work.node_elements)
        kernels.combined_rates(work.elements, model.cells, work.springs, work.dashpots, work.rates)
        worst = int(np.argmax(work.rates))  # the first NaN, if there is one
        if not math.isfinite(work.rates[worst]):
            place = state.x[model.cells[worst]].mean(axis=0)
            raise SolverError(
                Status.NOT_FINITE,
                f"at {state.time:.6g} s element {int(model.soft_cells[worst])} at "
                f"({place[0]:.4g}, {place[1]:.4g}, {place[2]:.4g}) m has no finite stiffness",
            )
        square = max(square, float(work.rates[worst]))
        alone = max(alone, float(work.elements.max()))
    work.touched = math.sqrt(square) > TOUCHED * math.sqrt(alone)
    return math.sqrt(square)


def _margins(model: Model, state: State) -> list[float]:
    """How much deeper each contact may go before the step is chosen again [m]."""
    if state.dt_before == 0.0:
        return [RATE_MARGIN] * len(model.contacts)  # no step yet to judge by
    return [
        rate_margin(contact.near_travel(state.v, history, state.dt_before, state.travel))
        for contact, history in zip(model.contacts, state.histories, strict=True)
    ]


def _squared(springs: Any, dashpots: Any) -> Any:
    """Square of the frequency of the undamped system with the same largest step [1/s2]."""
    half = 0.5 * dashpots
    return (half + np.sqrt(half * half + springs)) ** 2


def _gather_owned(model: Model, work: Workspace) -> None:
    """Give each rigid body what acts on all of its nodes together, in the place of each node's.

    A force at a node moves the body by no more than `Model.inverse_mass` says of that node.
    """
    if not model.owned.size:
        return
    owner = model.owner[model.owned]
    for rates in (work.springs, work.dashpots):
        total = np.bincount(owner, weights=rates[model.owned], minlength=len(model.rigid.names))
        rates[model.owned] = total[owner]


def _estimate_elements(model: Model, state: State, work: Workspace) -> None:
    """Bounds of the elements alone, into `work.elements`."""
    body = model.body
    assert body is not None
    if not work.tangents.size:
        work.tangents = np.empty((model.soft_cells.size, fem_kernels.PAIR_COUNT, 3, 3))
    u = state.u[: model.mesh_node_count]
    fem_kernels.predict_pressure(
        u,
        np.zeros_like(u),
        model.cells,
        model.gradients,
        model.weights,
        model.cell_material,
        body.kappa,
        work.cell_pressure,
    )
    fem_kernels.element_tangents(
        u,
        model.cells,
        model.gradients,
        model.weights,
        model.cell_material,
        body.mu,
        body.alpha,
        body.c,
        body.kappa_point,
        body.kappa,
        work.cell_pressure,
        work.tangents,
    )
    # Branches that have no time to relax stiffen the deviatoric part; the bound takes all.
    stiffening = 1.0 if model.viscous is None else float(model.viscous.stiffening.max())
    kernels.element_rates(
        work.tangents,
        fem_kernels.PAIR_OF,
        model.cells,
        model.element_mass,
        stiffening,
        work.elements,
    )


def stable_step(omega: float, model: Model) -> float:
    """Stable step [s] of central differences at the highest frequency `omega`, with its damping."""
    if omega == 0.0:
        return math.inf
    ratio = model.damping.stiffness + 0.5 * model.damping.mass / omega
    return 2.0 / omega * (math.sqrt(1.0 + ratio * ratio) - ratio)


def scale_mass(model: Model, state: State, work: Workspace, target: float) -> float:
    """Selective mass scaling: make heavier the elements whose own step is below `target` [s].

    Returns the mass added [kg], which `model.scaled_mass` keeps: it is inert and weighs nothing.
    """
    if model.internal is None:
        return 0.0
    highest_frequency(model, state, work)
    wanted = (2.0 / target) ** 2
    factor = np.maximum(work.rates / wanted - 1.0, 0.0)
    added = factor[:, None] * model.element_mass
    # Nodes of rigid bodies are as heavy as these.
    added[model.owner[model.cells] >= 0] = 0.0
    total = np.bincount(model.cells.ravel(), weights=added.ravel(), minlength=model.node_count)
    model.mass = model.mass + total
    model.scaled_mass += float(total.sum())
    # Each element keeps what it was given: shared out by volume it would go to its neighbours.
    model.element_mass += added
    work.inverse_mass = model.inverse_mass()
    return float(total.sum())
