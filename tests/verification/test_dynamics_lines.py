"""Line elements, coils and bending curves of the explicit engine against closed forms."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from flexapod.contact.ground import slope
from flexapod.contact.law import ContactLaw, FrictionLaw, hertz_stiffness
from flexapod.core.errors import InputError, SolverError, Status
from flexapod.dynamics import integrator, line_kernels
from flexapod.dynamics.actuation import Actuation
from flexapod.dynamics.ground_contact import GroundContact
from flexapod.dynamics.integrator import Options, energies, march
from flexapod.dynamics.lines import Coils, Hinges, Lines, LineSystem, Points, pack_history
from flexapod.dynamics.model import Damping, Model, State
from flexapod.dynamics.workspace import Workspace
from flexapod.geometry.ring import RingSizes, lumped_ring

LETTERS = tuple("ABCDEFGH")


def alone(points: Points, system: LineSystem, **more: object) -> Model:
    """A model of points and lines."""
    return Model(None, points=points, lines=system, **more)  # type: ignore[arg-type]


def run(model: Model, time: float, interval: float, **more: object) -> tuple[State, Workspace]:
    """March from the start for `time` [s]."""
    state, work = model.start(), Workspace(model)
    march(model, state, work, round(time / interval), Options(interval, **more))  # type: ignore[arg-type]
    return state, work


def wild_curve(count: int, seed: int) -> tuple[np.ndarray, Hinges]:
    """A closed curve in space, bent in and out of its plane, and its bending."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(count) / count
    x = np.stack([np.cos(angle), 0.3 * np.sin(2.0 * angle), 0.8 * np.sin(angle)], axis=1)
    x += 0.05 * rng.standard_normal(x.shape)
    hinges = Hinges((np.arange(count),), ((0.7, 0.4),), (0.3,), (0.0,))
    return x, hinges


def bending(x: np.ndarray, hinges: Hinges) -> tuple[float, np.ndarray]:
    """Energy [J] and forces [N]."""
    history = LineSystem(Lines.between([], length=1.0, stiffness=0.0), hinges=hinges).start(x)
    force = np.zeros_like(x)
    energy = line_kernels.hinge_forces(x, 0.0, hinges.packed(), pack_history(history), force)
    return energy, force


def test_bending_forces_are_the_slope_of_the_energy() -> None:
    """Central differences with h = 1e-6: their own error is some 1e-10 of the largest force."""
    x, hinges = wild_curve(12, 3)
    _, force = bending(x, hinges)
    h = 1e-6
    slope_ = np.zeros_like(x)
    for node in range(len(x)):
        for axis in range(3):
            values = []
            for sign in (1.0, -1.0):
                moved = x.copy()
                moved[node, axis] += sign * h
                values.append(bending(moved, hinges)[0])
            slope_[node, axis] = (values[0] - values[1]) / (2.0 * h)
    np.testing.assert_allclose(force, -slope_, atol=1e-8 * np.abs(force).max())


def test_bending_keeps_momentum_and_angular_momentum() -> None:
    """Though the plane of the curve depends on all its nodes; to round-off."""
    x, hinges = wild_curve(16, 5)
    _, force = bending(x, hinges)
    size = np.abs(force).max()
    assert np.abs(force.sum(axis=0)).max() < 1e-13 * size * len(x)
    assert np.abs(np.cross(x, force).sum(axis=0)).max() < 1e-13 * size * len(x)


def test_bending_does_not_feel_rigid_motion() -> None:
    """Turned and moved, the energy stays and the forces turn along; to round-off."""
    from scipy.spatial.transform import Rotation

    x, hinges = wild_curve(10, 7)
    turn = Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix()
    energy, force = bending(x, hinges)
    other, turned = bending(x @ turn.T + [3.0, -2.0, 5.0], hinges)
    assert other == pytest.approx(energy, rel=1e-12)
    np.testing.assert_allclose(turned, force @ turn.T, atol=1e-12 * np.abs(force).max())


def test_waves_out_of_the_plane_store_what_beam_theory_says() -> None:
    """w = e cos(m a) on a circle: U = EI_out pi m**4 e**2 / (2 R**3), of second order in 1/n.

    Twist is left out of the curve, so that this is the energy of bending alone. To 2 % at 96 nodes:
    the second difference of a cosine is short by (m 2 pi / n)**2 / 12 of it, squared.
    """
    radius, rigidity, mode, height = 0.02, 2e-5, 3, 1e-5
    errors = []
    for count in (48, 96):
        angle = 2.0 * np.pi * np.arange(count) / count
        x = np.stack(
            [radius * np.cos(angle), radius * np.sin(angle), height * np.cos(mode * angle)], axis=1
        )
        edge = 2.0 * radius * math.sin(math.pi / count)
        k = rigidity / edge
        hinges = Hinges((np.arange(count),), ((0.0, k),), (2.0 * math.pi / count,))
        exact = rigidity * math.pi * mode**4 * height**2 / (2.0 * radius**3)
        errors.append(abs(bending(x, hinges)[0] / exact - 1.0))
    assert errors[1] < 0.02
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def pinched(count: int) -> float:
    """Shortening [m] of a ring's diameter under two forces of 1 mN, at rest."""
    radius, rigidity, force = 0.02, 2.4e-5, 1e-3
    angle = 2.0 * np.pi * np.arange(count) / count
    x = np.stack([radius * np.sin(angle), 0.0 * angle, -radius * np.cos(angle)], axis=1)
    edge = 2.0 * radius * math.sin(math.pi / count)
    shell = Lines.between(
        [(k, (k + 1) % count) for k in range(count)],
        length=edge,
        stiffness=8.0 / edge,
        damping=0.0,
    )
    hinges = Hinges((np.arange(count),), ((rigidity / edge,) * 2,), (2.0 * math.pi / count,))
    # A coil that pulls with 1 mN between opposite nodes is the pair of forces.
    pull = Lines.between([(0, count // 2)], length=2 * radius, stiffness=0.0, coil=0)
    actuation = Actuation(("A",), np.array([0.0]), np.array([[True]]))
    coils = Coils(np.array([1.0]), np.array([1.0]), np.array([force]), actuation)
    fixed = np.zeros((count, 3), dtype=bool)
    fixed[:, 1] = True
    model = alone(
        Points(x, np.full(count, 3e-3 / count), fixed),
        LineSystem(Lines.joined(shell, pull), coils, hinges),
        damping=Damping(mass=60.0),
    )
    state, _ = run(model, 0.5, 0.05)
    return 2.0 * radius - float(np.linalg.norm(state.x[0] - state.x[count // 2]))


def test_a_pinched_ring_gives_way_as_a_curved_beam() -> None:
    """F R**3/EI (pi/4 - 2/pi) + pi F R/(4 EA) (Timoshenko); of second order in 1/n.

    The force is small, so that the deflection's own square is below 1e-3 of it; 2 % at 48 nodes is
    what the order of the coarser two extrapolates to, with a margin of two.
    """
    radius, rigidity, force, stretch = 0.02, 2.4e-5, 1e-3, 8.0
    exact = force * radius**3 / rigidity * (math.pi / 4.0 - 2.0 / math.pi)
    exact += math.pi * force * radius / (4.0 * stretch)
    errors = [abs(pinched(count) / exact - 1.0) for count in (12, 24, 48)]
    assert errors[2] < 0.02
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([2.0, 2.0], abs=0.2), f"errors {errors}"


def two_masses(damping: float, **more: object) -> Model:
    """Masses of 2 g on a Voigt element of 50 N/m, 10 mm apart, stretched by 1 mm."""
    x = np.array([[0.0, 0.0, 0.0], [0.011, 0.0, 0.0]])
    lines = Lines.between([(0, 1)], length=0.01, stiffness=50.0, damping=damping, **more)  # type: ignore[arg-type]
    return alone(Points(x, np.full(2, 2e-3)), LineSystem(lines))


def test_an_oscillator_of_two_masses_is_of_second_order() -> None:
    """Undamped, omega = sqrt(2 k / m); error in the place after 40 ms against the step."""
    omega = math.sqrt(2.0 * 50.0 / 2e-3)
    errors = []
    for dt in (4e-4, 2e-4, 1e-4):
        state, _ = run(two_masses(0.0), 0.04, 0.004, time_step=dt)
        stretch = state.x[1, 0] - state.x[0, 0] - 0.01
        errors.append(abs(stretch - 1e-3 * math.cos(omega * 0.04)))
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([2.0, 2.0], abs=0.1), f"errors {errors}"


def test_a_damped_oscillator_decays_as_its_law_says() -> None:
    """m x'' = -2 b x' - 2 k x of the stretch; first order, since the rate is half a step old."""
    stiffness, damping, mass, time = 50.0, 0.1, 2e-3, 0.02
    rate = damping / mass
    omega = math.sqrt(2.0 * stiffness / mass - rate**2)
    exact = (
        1e-3
        * math.exp(-rate * time)
        * (math.cos(omega * time) + rate / omega * math.sin(omega * time))
    )
    errors = []
    for dt in (1e-4, 5e-5, 2.5e-5):
        state, _ = run(two_masses(damping), time, 0.004, time_step=dt)
        errors.append(abs(state.x[1, 0] - state.x[0, 0] - 0.01 - exact))
    assert errors[-1] < 1e-5
    orders = [math.log2(a / b) for a, b in itertools.pairwise(errors)]
    assert orders == pytest.approx([1.0, 1.0], abs=0.15), f"errors {errors}"


def test_a_coil_pulls_as_it_is_switched_whatever_the_step() -> None:
    """Its force is exact at any time: on 0.1 to 0.7 s, up 0.15 N/s, limit 60 mN, then down."""
    x = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    lines = Lines.between([(0, 1)], length=0.02, stiffness=1.0, coil=0)
    actuation = Actuation.table(("A",), {"A": ((0.1, 0.7),)}, 2.0)
    coils = Coils(np.array([0.15]), np.array([0.1]), np.array([0.06]), actuation)
    fixed = np.ones((2, 3), dtype=bool)
    for dt in (7.3e-3, 1e-3):
        model = alone(Points(x, np.full(2, 1e-3), fixed), LineSystem(lines, coils))
        state, work = model.start(), Workspace(model)
        for time, force in ((0.05, 0.0), (0.3, 0.03), (0.6, 0.06), (0.9, 0.04), (1.5, 0.0)):
            march(model, state, work, round(time / 0.05), Options(0.05, time_step=dt))
            # What the next step will see at the end of the interval.
            kept = state.lines["active"].copy()
            line_kernels.advance_active(
                coils.packed(), state.time - state.dt_before, state.time, kept, np.zeros(1)
            )
            assert kept[0] == pytest.approx(force, abs=1e-12)


def crawler(count: int = 16, tilt: float = 0.0) -> Model:
    """A ring with eight coils on the ground, pattern BF at 0.6 s."""
    sizes = RingSizes(node_count=count)
    layout = lumped_ring(sizes)
    shell = Lines.between(
        [(int(a), int(b)) for a, b in layout.segments],
        length=layout.segment_length,
        stiffness=sizes.element_stiffness,
        damping=sizes.element_damping,
    )
    spokes = Lines.between(
        [layout.spokes[name] for name in LETTERS],
        length=sizes.radius,
        stiffness=50.0,
        damping=0.1,
        flow_damping=10.0,
        limit=0.016,
        coil=np.arange(8),
    )
    force = np.full(8, 0.15)
    actuation = Actuation.pattern("ABCDEFGH", "BF", interval=0.6, duration=6.0)
    hinges = Hinges(layout.rings, ((sizes.hinge_stiffness,) * 2,), (float(layout.rest_angle[0]),))
    fixed = np.zeros(layout.nodes.shape, dtype=bool)
    fixed[:, 1] = True
    law = ContactLaw(hertz_stiffness(4e5, 0.45, math.inf, 0.3, 500.0, 500.0))
    touching = layout.touching(4)
    ground = GroundContact(
        "ground",
        layout.nodes,
        touching.faces,
        slope(tilt, friction=FrictionLaw.constant(0.8)),
        law,
        skin=1e-3,
        areas=touching.areas,
        curve=(touching.nodes, touching.weights),
    )
    return alone(
        Points(layout.nodes, layout.node_mass, fixed),
        LineSystem(Lines.joined(shell, spokes), Coils(force, force, force, actuation), hinges),
        contacts=[ground],
        gravity=(0.0, 0.0, -9.8),
    )


def test_walking_through_an_interval_is_a_row_of_single_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """To 1e-9 of the way: a compiler may fuse a product and a sum in one of them and not the other.

    The first roll of a crawling ring, in which points land, slide, stick and leave.
    """
    fast, _ = run(crawler(), 1.2, 0.02)
    monkeypatch.setattr(integrator.LineMarch, "serves", staticmethod(lambda model: False))
    slow, _ = run(crawler(), 1.2, 0.02)
    assert fast.step_count == slow.step_count
    assert np.abs(fast.x - crawler().nodes).max() > 1e-3
    np.testing.assert_allclose(fast.x, slow.x, atol=1e-9)
    np.testing.assert_allclose(fast.lines["spent"], slow.lines["spent"], rtol=1e-6)
    np.testing.assert_allclose(fast.works, slow.works, rtol=1e-6, atol=1e-12)


def test_the_books_of_a_crawling_ring_close_as_the_step_shrinks() -> None:
    """Work of coils = stored + lost; what is missing falls at least in proportion to the step."""
    missing = []
    for safety in (0.9, 0.45, 0.225):
        model = crawler()
        state, work = model.start(), Workspace(model)
        kept = []

        def record(state: State, model: Model = model, work: Workspace = work) -> None:
            kept.append(energies(model, state, work))  # noqa: B023

        march(model, state, work, 40, Options(0.02, safety=safety), record)
        coil_work = kept[-1].coil_work
        assert coil_work > 1e-4
        missing.append(max(abs(e.unaccounted) for e in kept) / coil_work)
    assert missing[0] < 5e-3
    assert missing[2] < 0.6 * missing[1] < 0.36 * missing[0], f"missing {missing}"


def test_a_ring_goes_on_from_a_checkpoint_with_the_same_bits() -> None:
    """Everything lines remember is in the state."""
    whole, _ = run(crawler(), 0.3, 0.02)
    model = crawler()
    state, work = model.start(), Workspace(model)
    march(model, state, work, 7, Options(0.02))
    again = crawler()
    other = State.from_arrays(*state.to_arrays())
    march(again, other, Workspace(again), 15, Options(0.02))
    assert (other.x == whole.x).all()
    assert (other.lines["extension"] == whole.lines["extension"]).all()


def test_a_ring_that_falls_through_the_ground_says_where() -> None:
    """As other bodies do: named by contact, face and place."""
    model = crawler()
    model.contacts[0].deepest = 1e-6  # of the ten it sinks in by its weight
    with pytest.raises(SolverError, match="ground: the face of nodes") as caught:
        run(model, 0.1, 0.02)
    assert caught.value.status is Status.FELL_THROUGH


def test_an_end_of_several_nodes_pulls_them_alike() -> None:
    """The middle of three nodes: each gets a third of the force."""
    x = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0], [0.02, 0.002, 0.0], [0.02, -0.002, 0.0]])
    lines = Lines.between([(0, np.array([1, 2, 3]))], length=0.01, stiffness=30.0)
    system = LineSystem(lines)
    force = np.zeros_like(x)
    history = system.start(x)
    energy = system.add_forces(x, np.zeros_like(x), 0.0, 0.0, history, force)
    np.testing.assert_allclose(force[:, 0], [0.3, -0.1, -0.1, -0.1], rtol=1e-12)
    assert energy == pytest.approx(0.5 * 30.0 * 0.01**2)


@pytest.mark.parametrize(
    ("more", "text"),
    [
        ({"stiffness": -1.0}, "stiffness of a line must be >= 0, got -1 N/m"),
        ({"stiffness": 1.0, "damping": math.nan}, "damping of a line"),
        ({"stiffness": 1.0, "length": 0.0}, "length of a line must be > 0"),
        ({"stiffness": 1.0, "limit": -0.1}, "limit of a line"),
    ],
)
def test_bad_lines_are_refused_by_name(more: dict[str, float], text: str) -> None:
    """Rule, name and value."""
    with pytest.raises(InputError, match=text):
        Lines.between([(0, 1)], **{"length": 1.0, **more})  # type: ignore[arg-type]
