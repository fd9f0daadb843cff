"""Many steps of a model of line elements in one call; `line_kernels.march` says how."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from flexapod.dynamics import line_kernels
from flexapod.dynamics.contacts import TOTALS
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.line_kernels import GroundArrays, NodeArrays
from flexapod.dynamics.lines import pack_history

if TYPE_CHECKING:
    from flexapod.dynamics.model import Model, State
    from flexapod.dynamics.workspace import Workspace


class LineMarch:
    """Many steps in one call, for a model of line elements with one ground at most."""

    def __init__(self, model: Model, state: State, work: Workspace) -> None:
        assert model.lines is not None
        self.model, self.state, self.work = model, state, work
        self.nodes = NodeArrays(
            model.nodes,
            model.mass,
            model.own_mass,
            model.owner,
            model.fixed,
            state.u,
            state.x,
            state.v,
            work.elastic,
            work.dissipative,
            work.viscous,
            work.total,
            work.parts,
        )
        self.out = np.zeros(3)
        contact = model.contacts[0] if model.contacts else None
        self.contact = contact if isinstance(contact, GroundContact) else None
        self.ground = self._ground()

    @staticmethod
    def serves(model: Model) -> bool:
        """Whether nothing but line elements and one ground acts."""
        if model.lines is None or model.body is not None or model.rigid.names:
            return False
        if model.chambers or model.bonds or len(model.contacts) > 1:
            return False
        return all(isinstance(contact, GroundContact) for contact in model.contacts)

    def _ground(self) -> GroundArrays:
        if self.contact is None:
            none, nobody = np.zeros((0, 4)), np.zeros(0, dtype=np.int64)
            return GroundArrays(
                np.zeros((0, 4), dtype=np.int64), none, 0, np.zeros(8), np.zeros((2, 2)),
                (0.0,) * 10, 0.0, 0.0, 1.0, np.zeros((0, 4, 3)), nobody, nobody, np.zeros(1),
                np.zeros(1), np.zeros(3), none, none, np.zeros(TOTALS),
                np.zeros((0, 4), dtype=np.int64), none, *np.zeros((4, 0, 3)),
            )  # fmt: skip
        return self.contact.packed(self.state.histories[0])

    def march(
        self, begin: float, dt: float, count: int, allowed: list[float]
    ) -> tuple[int, float, int]:
        """Up to `count` steps of `dt` [s] from time `begin` [s], until a contact has changed.

        Returns the steps done, the deepest point met [m], and how it ended: `line_kernels.DONE`,
        `DEEPER` than `allowed` [m], or `TROUBLE`, which the caller names.
        """
        model, state, work = self.model, self.state, self.work
        lines = model.lines
        assert lines is not None
        end = line_kernels.march(
            begin,
            dt,
            count,
            state.dt_before,
            state.travel,
            model.gravity,
            model.damping.mass,
            allowed[0] if allowed else math.inf,
            self.nodes,
            lines.arrays,
            lines.coil_arrays,
            lines.hinge_arrays,
            pack_history(state.lines),
            lines.active_before,
            self.ground,
            state.works,
            work.sums,
            self.out,
        )
        done = int(self.out[0])
        if done:
            state.dt_before = dt
        state.travel = float(self.out[1])
        state.step_count += done
        return done, float(self.out[2]), int(end)
