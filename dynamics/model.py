"""What does not change in a run (`Model`), what moves (`State`), and how a state is kept."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from flexapod.core.errors import InputError
from flexapod.dynamics import joint_kernels
from flexapod.dynamics.commands import Chamber, chamber_names
from flexapod.dynamics.contacts import DynamicContact, History
from flexapod.dynamics.joints import JointSystem
from flexapod.dynamics.lines import LineSystem, Points
from flexapod.dynamics.rigid import RigidBodies
from flexapod.fem.body import SolidBody
from flexapod.fem.loads import Conditions, Displacement
from flexapod.fem.residual_kernels import InternalForce
from flexapod.fem.viscous import ViscousForce


@dataclass(frozen=True)
class Damping:
    """Damping beyond contact and material; everything is off by default.

    Attributes
    ----------
    mass
        Rate [1/s] of a force ``-rate m v``: it slows rigid motion too, so it is for settling.
    stiffness
        Fraction of critical damping at the mesh's highest frequency (a bulk-viscosity-like
        coefficient, 0.06 is usual): ``K v`` times twice this over that frequency. It calms what the
        mesh does not resolve and costs about that fraction of the stable step. Its force is the
        internal one of a shape a little ahead, so angular momentum is kept but for that lead.
    """

    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        if not (self.mass >= 0.0 and np.isfinite(self.mass)):
            raise InputError(f"mass damping must be finite and >= 0, got {self.mass:g} 1/s")
        if not 0.0 <= self.stiffness <= 1.0:
            raise InputError(f"stiffness damping must lie in [0, 1], got {self.stiffness:g}")


@dataclass(frozen=True)
class Bond:
    """Rods between pairs of nodes that hold until their resultant is too large.

    Attributes
    ----------
    name
        For reports.
    pairs
        Node numbers, shape (pair_count, 2).
    stiffness
        Of each pair [N/m], shape (pair_count,).
    length
        At rest [m], shape (pair_count,).
    strength
        Resultant [N] at which it opens for good; infinite for a weld.
    damping
        Dashpot over spring [s].
    draw_time
        Time [s] from the start in which the rods shorten smoothly to nothing and draw the two
        surfaces together; 0 leaves them as long as they are.
    """

    name: str
    pairs: np.ndarray
    stiffness: np.ndarray
    length: np.ndarray
    strength: float = float("inf")
    damping: float = 0.0
    draw_time: float = 0.0

    def length_left(self, time: float) -> float:
        """Share of `length` the rods have at `time` [s]."""
        if self.draw_time == 0.0:
            return 1.0
        a = min(time / self.draw_time, 1.0)
        return 1.0 - a * a * a * (10.0 + a * (6.0 * a - 15.0))


# Rods from each node of a bond's first surface that is held with its gap: three do not lie in one
# plane, so that they hold the other surface sideways too.
RODS = 3


def bond_pairs(
    x: np.ndarray, first: np.ndarray, second: np.ndarray, closed: bool
) -> tuple[np.ndarray, int]:
    """Node pairs of a bond of two surfaces at positions `x` [m], and the rods per first node.

    `closed`: each node with the one it meets when the surfaces come together, nearest as seen
    along the line between their middles. Else: with its nearest ones.
    """
    from scipy.spatial import cKDTree

    one, two = x[first], x[second]
    count = 1 if closed else min(RODS, len(second))
    along = np.eye(3)
    if closed:
        line = two.mean(axis=0) - one.mean(axis=0)
        line /= max(float(np.linalg.norm(line)), 1e-12)
        along -= np.outer(line, line)
    _, nearest = cKDTree(two @ along).query(one @ along, k=count)
    return np.stack([np.repeat(first, count), second[np.reshape(nearest, -1)]], axis=1), count


class Model:
    """Soft body, rigid bodies and everything that acts on them.

    Parameters
    ----------
    body
        The soft body, or None. Its mesh's nodes come first in the global node array.
    points
        Nodes without a body, numbered after the mesh's.
    lines
        Line elements, coils and bending curves between nodes; they use global node numbers.
    rigid
        Rigid bodies, with their centres at the start [m], shape (rigid_count, 3).
    rigid_nodes
        Positions [m] and owners of the surface nodes of rigid bodies, appended after the points.
    joints
        Revolute joints with servos between rigid bodies.
    tied
        Node numbers of the mesh each rigid body carries, by its name. Cells whose corners all
        belong to one rigid body have no stiffness.
    carried_mass
        Mass [kg] added to the mesh's nodes, shape (mesh_node_count,).
    displacements
        Supports; prescribed motion is not offered here.
    gravity
        Acceleration [m/s2].
    chambers, contacts, bonds, damping
        What acts. Contacts and bonds use global node numbers.

    Attributes
    ----------
    nodes
        All reference positions [m], shape (node_count, 3).
    rigid_start
        Number of the first surface node of a rigid body.
    mass
        Lumped mass [kg], shape (node_count,); that of a node with an owner is its share of the
        body it belongs to and serves the stable step only.
    owner
        Row of the rigid body a node belongs to, or -1, shape (node_count,).
    """

    def __init__(
        self,
        body: SolidBody | None,
        *,
        points: Points | None = None,
        lines: LineSystem | None = None,
        rigid: RigidBodies | None = None,
        rigid_centres: np.ndarray | None = None,
        rigid_nodes: tuple[np.ndarray, np.ndarray] | None = None,
        joints: JointSystem | None = None,
        tied: Mapping[str, np.ndarray] | None = None,
        carried_mass: np.ndarray | None = None,
        displacements: Sequence[Displacement] = (),
        gravity: Sequence[float] = (0.0, 0.0, 0.0),
        chambers: Sequence[Chamber] = (),
        contacts: Sequence[DynamicContact] = (),
        bonds: Sequence[Bond] = (),
        damping: Damping | None = None,
    ) -> None:
        self.body = body
        self.rigid = rigid or RigidBodies.empty()
        rigid_count = len(self.rigid.names)
        centres = np.zeros((0, 3)) if rigid_centres is None else np.asarray(rigid_centres, float)
        if centres.shape != (rigid_count, 3):
            raise InputError(f"{rigid_count} rigid bodies need as many centres")
        self.rigid_centres = centres
        extra, extra_owner = rigid_nodes or (np.zeros((0, 3)), np.zeros(0, dtype=np.int32))
        mesh_nodes = body.nodes if body is not None else np.zeros((0, 3))
        self.points = points or Points(np.zeros((0, 3)), np.zeros(0))
        self.lines = lines
        self.joints = joints
        self.mesh_node_count = mesh_nodes.shape[0]
        self.rigid_start = self.mesh_node_count + len(self.points.mass)
        self.nodes = np.ascontiguousarray(
            np.concatenate([mesh_nodes, self.points.x, extra]), dtype=float
        )
        self.owner = np.full(self.nodes.shape[0], -1, dtype=np.int32)
        self.owner[self.rigid_start :] = extra_owner
        for name, nodes in (tied or {}).items():
            if name not in self.rigid.names:
                raise InputError(f"nodes are tied to {name!r}, which is no rigid body")
            row = self.rigid.names.index(name)
            if (self.owner[nodes] >= 0).any():
                raise InputError(f"a node tied to {name!r} belongs to another rigid body already")
            self.owner[nodes] = row
        self.owned = np.flatnonzero(self.owner >= 0)
        self.local = np.zeros_like(self.nodes)
        self.local[self.owned] = self.nodes[self.owned] - centres[self.owner[self.owned]]
        self.fixed = np.zeros(self.nodes.shape, dtype=bool)
        if body is not None:
            self.fixed[: self.mesh_node_count] = Conditions(
                self.mesh_node_count, displacements
            ).fixed
        if self.points.fixed is not None:
            self.fixed[self.mesh_node_count : self.rigid_start] = self.points.fixed
        self.gravity = np.asarray(gravity, dtype=float)
        self.chambers = list(chambers)
        self.contacts = list(contacts)
        self.bonds = list(bonds)
        self.damping = damping or Damping()
        chamber_names(self.chambers)
        self.cavities = [c.cavity() if c.command.needs_volume else None for c in self.chambers]
        self._set_soft(carried_mass)
        self._set_faces()
        free = self.owner < 0
        if (self.mass[free] <= 0.0).any():
            bare = int(np.flatnonzero(free & (self.mass <= 0.0))[0])
            raise InputError(f"node {bare} has no mass")
        self.own_mass = self.mass  # that which has weight
        self.scaled_mass = 0.0  # added by selective mass scaling [kg]

    @property
    def node_count(self) -> int:
        """All nodes."""
        return int(self.nodes.shape[0])

    def inverse_mass(self) -> np.ndarray:
        """Bound of a node's acceleration per force at it [1/kg], shape (node_count,).

        A node of a rigid body moves as the body does: the largest eigenvalue of
        ``1/m - [r] I^-1 [r]``, with the cross product's matrix of its place from the centre.
        """
        inverse = 1.0 / self.mass
        if self.owned.size:
            row = self.owner[self.owned]
            x, y, z = self.local[self.owned].T
            cross = np.zeros((self.owned.size, 3, 3))
            cross[:, 0, 1], cross[:, 0, 2], cross[:, 1, 2] = -z, y, -x
            cross -= np.swapaxes(cross, 1, 2)
            moved = -cross @ np.linalg.inv(self.rigid.inertia)[row] @ cross
            inverse[self.owned] = 1.0 / self.rigid.mass[row] + np.linalg.eigvalsh(moved)[:, -1]
        return inverse

    def _set_soft(self, carried_mass: np.ndarray | None) -> None:
        body, owner = self.body, self.owner
        self.mass = np.zeros(self.node_count)
        self.mass[self.mesh_node_count : self.rigid_start] = self.points.mass
        self.soft_cells = np.zeros(0, dtype=np.int64)
        self.internal: InternalForce | None = None
        self.viscous: ViscousForce | None = None
        count = np.bincount(owner[self.owned], minlength=len(self.rigid.names))
        if body is not None:
            self.mass[: self.mesh_node_count] = body.node_mass
            if carried_mass is not None:
                self.mass[: self.mesh_node_count] += carried_mass
            corner = owner[body.cells]
            one = (corner >= 0).all(axis=1) & (corner == corner[:, :1]).all(axis=1)
            self.soft_cells = np.flatnonzero(~one)
        self.mass[self.owned] = (self.rigid.mass / np.maximum(count, 1))[owner[self.owned]]
        if body is None or not self.soft_cells.size:
            return
        cells = self.soft_cells
        self.internal = InternalForce(
            body.nodes,
            body.cells[cells],
            body.material[cells],
            body.mu,
            body.alpha,
            body.c,
            body.kappa,
            body.kappa_point,
        )
        self.cells = np.ascontiguousarray(body.cells[cells])
        self.cell_material = np.ascontiguousarray(body.material[cells])
        self.gradients = np.ascontiguousarray(body.gradients[cells])
        self.weights = np.ascontiguousarray(body.weights[cells])
        self.set_element_mass()
        series = [material.prony for material in body.materials]
        used = np.unique(self.cell_material)
        if any(series[row] is not None for row in used):
            self.viscous = ViscousForce(
                self.mesh_node_count,
                self.cells,
                self.gradients,
                self.weights,
                self.cell_material,
                body.mu,
                body.alpha,
                body.c,
                series,
            )

    def set_element_mass(self) -> None:
        """Each corner's part of its node's mass, by the volume of the cells that meet there."""
        volume = np.repeat(self.weights.sum(axis=1) / 8.0, 8)
        total = np.bincount(self.cells.ravel(), weights=volume, minlength=self.node_count)
        share = volume / total[self.cells.ravel()]
        self.element_mass = (share * self.mass[self.cells.ravel()]).reshape(-1, 8)

    def _set_faces(self) -> None:
        """All chambers' faces in one list, with the corners of each node."""
        faces = [c.faces for c in self.chambers]
        self.faces = np.ascontiguousarray(
            np.concatenate(faces) if faces else np.zeros((0, 4)), dtype=np.int64
        )
        self.face_chamber = np.repeat(np.arange(len(faces)), [len(f) for f in faces]).astype(
            np.int32
        )
        flat = self.faces.ravel()
        self.face_entry = np.argsort(flat, kind="stable")
        self.face_nodes, counts = np.unique(flat, return_counts=True)
        self.face_start = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)

    def start(self, u: np.ndarray | None = None, velocity: np.ndarray | None = None) -> State:
        """State at time zero.

        Parameters
        ----------
        u
            Displacements of the mesh's nodes [m], shape (mesh_node_count, 3); a rigid body takes
            the rigid motion that fits its tied nodes best.
        velocity
            Of the mesh's nodes [m/s]; rigid bodies start at rest, see `State`.
        """
        rigid_x, rigid_q, rigid_v, rigid_l = self.rigid.initial_state(self.rigid_centres)
        state = State(
            u=np.zeros_like(self.nodes),
            v=np.zeros_like(self.nodes),
            x=self.nodes.copy(),
            rigid_x=rigid_x,
            rigid_q=rigid_q,
            rigid_v=rigid_v,
            rigid_l=rigid_l,
            gas=np.zeros(len(self.chambers)),
            works=np.zeros(7),
            whole=np.ones(len(self.bonds), dtype=bool),
        )
        if self.joints is not None:
            state.joints = self.joints.start()
        if u is not None:
            state.u[: self.mesh_node_count] = u
            state.x += state.u
            self._fit_rigid(state)
        if u is not None or self.joints is not None:
            self._place_rigid(state)
        if velocity is not None:
            state.v[: self.mesh_node_count] = velocity
        for k, (chamber, cavity) in enumerate(zip(self.chambers, self.cavities, strict=True)):
            if cavity is not None:
                state.gas[k] = chamber.command.gas(cavity.volume(state.x))
        if self.viscous is not None:
            # A start shape has been at rest for long.
            scratch = np.zeros((self.mesh_node_count, 3))
            self.viscous.force(state.u[: self.mesh_node_count], float("inf"), scratch)
        state.histories = [contact.start(state.x) for contact in self.contacts]
        if self.lines is not None:
            state.lines = self.lines.start(state.x)
        return state

    def _fit_rigid(self, state: State) -> None:
        for k in range(len(self.rigid.names)):
            own = self.owned[self.owner[self.owned] == k]
            own = own[own < self.mesh_node_count]
            if own.size < 3:
                continue
            local, now = self.local[own], state.x[own]
            middle, centre = local.mean(axis=0), now.mean(axis=0)
            left, _, right = np.linalg.svd((local - middle).T @ (now - centre))
            if np.linalg.det(left @ right) < 0.0:
                left[:, -1] *= -1.0
            turn = (left @ right).T  # now = turn local
            state.rigid_q[k] = _quaternion(turn)
            state.rigid_x[k] = centre - turn @ middle
            for axis in range(3):
                if not self.rigid.free[k, axis]:
                    state.rigid_x[k, axis] = self.rigid_centres[k, axis]

    def _place_rigid(self, state: State) -> None:
        from flexapod.dynamics import rigid_kernels

        if self.joints is not None:
            self.joints.place_children(
                state.joints, state.rigid_x, state.rigid_q, self.rigid_centres
            )
        rigid_kernels.place(
            self.owned,
            self.owner,
            self.local,
            self.rigid.inertia,
            self.rigid.free,
            state.rigid_x,
            state.rigid_q,
            state.rigid_v,
            state.rigid_l,
            state.x,
            state.v,
        )
        state.u[self.owned] = state.x[self.owned] - self.nodes[self.owned]


def _quaternion(turn: np.ndarray) -> np.ndarray:
    """Unit quaternion (w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    return np.array([w, x, y, z])


@dataclass
class State:
    """All that moves; enough to go on from with the same bits.

    But for the history of viscous branches, which the model's `viscous` keeps: a checkpoint takes
    that too.

    Attributes
    ----------
    u, x
        Displacements and positions [m] at `time`, shape (node_count, 3).
    v
        Velocities [m/s] half a step before `time`, shape (node_count, 3).
    rigid_x, rigid_q, rigid_v, rigid_l
        Centres [m], quaternions (w, x, y, z), velocities [m/s] and angular momenta about the
        centre [kg m2/s]; the last two half a step before.
    gas
        Of each chamber, as its volume at atmospheric pressure [m3].
    works
        Accumulated [J]: 0 kinetic (not summed), 1 internal, 2 pressure, 3 contact damping and
        friction, 4 mass damping, 5 viscous branches, 6 bonds' breaking.
    whole
        Which bonds still hold.
    histories
        Of the contacts.
    lines
        What line elements remember, see `lines.LineSystem`; empty without.
    joints
        Of joints and servos, see `joints.JointState`; rotors' rates are half a step before. Empty
        without.
    interval, dt_before
        Whole control intervals done, and the length of the last step [s].
    """

    u: np.ndarray
    v: np.ndarray
    x: np.ndarray
    rigid_x: np.ndarray
    rigid_q: np.ndarray
    rigid_v: np.ndarray
    rigid_l: np.ndarray
    gas: np.ndarray
    works: np.ndarray
    whole: np.ndarray
    histories: list[History] = field(default_factory=list)
    lines: History = field(default_factory=dict)
    joints: History = field(default_factory=dict)
    interval: int = 0
    step_count: int = 0
    time: float = 0.0
    dt_before: float = 0.0
    travel: float = 0.0  # bound of a node's way in the last step [m]
    omega: float = 0.0  # highest frequency at the last estimate [rad/s]
    energy_start: float = float("nan")  # of all energies [J]
    strain_start: float = float("nan")  # of the strain energy [J]

    def begin_anew(self) -> None:
        """Make this the start of a motion: at rest, at time zero, with empty ledgers."""
        for history in self.histories:
            history["spent"][:] = 0.0
        if self.lines:
            self.lines["spent"][:] = 0.0
        if self.joints:
            self.joints["spent"][:] = 0.0
            self.joints["motion"][:, joint_kernels.RATE] = 0.0
            for key in ("begun", "turn"):  # what a sensing gait has begun
                self.joints.pop(key, None)
        for array in (self.v, self.rigid_v, self.rigid_l, self.works):
            array[:] = 0.0
        self.interval = self.step_count = 0
        self.time = self.dt_before = self.travel = 0.0
        self.energy_start = self.strain_start = float("nan")

    def to_arrays(self) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Arrays and numbers of a checkpoint; `from_arrays` takes them back."""
        names = ("u", "v", "x", "rigid_x", "rigid_q", "rigid_v", "rigid_l", "gas", "works", "whole")
        arrays = {name: getattr(self, name) for name in names}
        for k, history in enumerate(self.histories):
            arrays.update({f"history{k}.{key}": value for key, value in history.items()})
        arrays.update({f"lines.{key}": value for key, value in self.lines.items()})
        arrays.update({f"joints.{key}": value for key, value in self.joints.items()})
        scalars = (
            "interval",
            "step_count",
            "time",
            "dt_before",
            "travel",
            "omega",
            "energy_start",
            "strain_start",
        )
        about = {name: getattr(self, name) for name in scalars}
        return arrays, {**about, "history_count": len(self.histories)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], about: Mapping[str, Any]) -> State:
        """A state as `to_arrays` wrote it."""
        histories: list[History] = [{} for _ in range(int(about["history_count"]))]
        lines: History = {}
        joints: History = {}
        plain: dict[str, Any] = {k: v for k, v in about.items() if k != "history_count"}
        for name, value in arrays.items():
            if name.startswith("history"):
                row, key = name.removeprefix("history").split(".", 1)
                histories[int(row)][key] = np.array(value)
            elif name.startswith("lines."):
                lines[name.removeprefix("lines.")] = np.array(value)
            elif name.startswith("joints."):
                joints[name.removeprefix("joints.")] = np.array(value)
            else:
                plain[name] = np.array(value)
        return cls(**plain, histories=histories, lines=lines, joints=joints)
