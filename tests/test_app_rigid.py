"""Rigid bodies described by shape and density: closed forms, what they carry, and refusals."""

from __future__ import annotations

import csv
import dataclasses
import math
from pathlib import Path

import h5py
import numpy as np
import pytest
from statics_helpers import grid

from flexapod.app import motion as motion_module
from flexapod.app import plots_skin
from flexapod.app.assemble import build_mesh
from flexapod.app.case import load_case
from flexapod.app.motion_model import Motion, assemble_motion
from flexapod.app.motion_rigid import rotation_vector
from flexapod.app.plots_rigid import RIGID, MixedSkin, painted, read_rigid, with_rigid
from flexapod.app.run import run_case
from flexapod.core.errors import InputError, Status
from flexapod.dynamics.rigid import box
from flexapod.geometry.meshfile import write_mesh
from flexapod.geometry.tagged import boundary_facets

G = 9.8
SIDE = 0.03  # of the soft block [m]

# A soft block on z = 0, and what each test adds.
HEAD = """
[mesh]
file = "block.vtu"
[[material]]
model = "neo-hooke"
mu = "70 kPa"
poisson = 0.45
density = "1000 kg/m^3"
"""
WEIGHTLESS = '[gravity]\nacceleration = ["0 m/s^2", "0 m/s^2", "0 m/s^2"]\n'


def _dynamics(duration: str, interval: str = "2 ms", more: str = "") -> str:
    return f'[dynamics]\nduration = "{duration}"\ninterval = "{interval}"\nframes = 2\n{more}\n'


@pytest.fixture(autouse=True)
def _no_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    plots_skin.renderer.cache_clear()
    monkeypatch.setenv("FLEXAPOD_RENDERER", "matplotlib")
    monkeypatch.setattr("flexapod.app.plots.draw_all", lambda folder: ([], []))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    mesh = grid((4, 4, 4), lambda x: (x - [0.5, 0.5, 0.0]) * SIDE)
    upper = np.flatnonzero(mesh.nodes[mesh.cells].mean(axis=1)[:, 2] > 0.75 * SIDE)
    mesh = dataclasses.replace(
        mesh,
        facet_groups={**mesh.facet_groups, "outer": boundary_facets(mesh.cells)},
        cell_groups={"lid": upper},
    )
    write_mesh(mesh, tmp_path / "block.vtu")
    return tmp_path


def _rows(folder: Path) -> dict[str, np.ndarray]:
    with (folder / "curve.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    return {head: np.array([float(row[head]) for row in rows]) for head in rows[0]}


def _run(folder: Path, text: str) -> dict[str, np.ndarray]:
    (folder / "case.toml").write_text(HEAD + text)
    result = run_case(load_case(str(folder / "case.toml")), folder / "out")
    assert result.status is Status.DONE, result.message
    return _rows(folder / "out")


def _motion(folder: Path, text: str, start: np.ndarray | None = None) -> Motion:
    (folder / "case.toml").write_text(HEAD + text)
    loaded = load_case(str(folder / "case.toml"))
    return assemble_motion(loaded, None if start is None else (loaded, start), lambda words: None)


# --------------------------------------------------------------------------- closed forms


FALLING = """
[gravity]
[[rigid]]
name = "box"
shape = "box"
size = ["10 mm", "10 mm", "2 mm"]
density = "2700 kg/m^3"
position = ["50 mm", "0 mm", "60 mm"]
velocity = ["0.3 m/s", "0 m/s", "0.5 m/s"]
spin = ["0 rad/s", "0 rad/s", "20 turn/s"]
turn = "90 deg"
turn_axis = [0, 0, 1]
[[rigid]]
name = "ball"
shape = "sphere"
radius = "5 mm"
mass = "4 g"
position = ["-50 mm", "0 mm", "60 mm"]
spin = ["0 rad/s", "-10 turn/s", "0 rad/s"]
"""


def test_free_fall_and_free_spin(folder: Path) -> None:
    rows = _run(folder, FALLING + _dynamics("80 ms"))
    t = rows["time_s"]
    # Leapfrog is exact in a uniform field; the file has ten digits of numbers up to 300 mm.
    near = {"rtol": 0.0, "atol": 1e-6}
    np.testing.assert_allclose(rows["rigid_box_x_mm"], 50.0 + 300.0 * t, **near)
    np.testing.assert_allclose(rows["rigid_box_z_mm"], 60.0 + 500.0 * t - 500.0 * G * t**2, **near)
    np.testing.assert_allclose(rows["rigid_ball_z_mm"], 60.0 - 500.0 * G * t**2, **near)
    # About a principal axis the spin stays: 1.6 and 0.8 turns, counted on. The exponential map of
    # the integrator is exact for it.
    np.testing.assert_allclose(rows["rigid_box_turn_z_deg"], 7200.0 * t, **near)
    np.testing.assert_allclose(rows["rigid_ball_turn_y_deg"], -3600.0 * t, **near)
    assert np.abs(rows["rigid_ball_turn_x_deg"]).max() < 1e-6
    # Nothing touches anything. The ledger takes the mean of two half steps for kinetic energy, and
    # the start's own: m (g dt)^2 / 8 between them.
    step = 1e-6 * rows["time_step_us"][1:].max()
    mass = 1000.0 * SIDE**3 + 5.4e-4 + 4e-3
    assert np.abs(rows["unaccounted_J"]).max() < 1.01 * mass * (G * step) ** 2 / 8.0


def test_a_body_is_as_heavy_as_its_shape_says(folder: Path) -> None:
    rigid = _motion(folder, FALLING + _dynamics("2 ms")).rigid
    mass, inertia = box((0.01, 0.01, 0.002), 2700.0)
    # Closed forms on both sides: round-off.
    assert rigid.bodies.mass == pytest.approx([mass, 0.004], rel=1e-14)
    # A quarter turn about z puts x for y.
    np.testing.assert_allclose(
        rigid.bodies.inertia[0], inertia[[1, 0, 2]][:, [1, 0, 2]], atol=1e-14 * inertia.max()
    )
    ball = 0.4 * 0.004 * 0.005**2
    np.testing.assert_allclose(rigid.bodies.inertia[1], ball * np.eye(3), atol=1e-14 * ball)


PILE = """
[gravity]
[[rigid]]
name = "load"
shape = "box"
size = ["20 mm", "20 mm", "8 mm"]
mass = "20 g"
position = ["0 mm", "0 mm", "34 mm"]
[[rigid]]
name = "stone"
shape = "box"
size = ["16 mm", "16 mm", "16 mm"]
density = "2000 kg/m^3"
position = ["60 mm", "0 mm", "8 mm"]
[[contact]]
type = "ground"
surface = "outer"
[[contact]]
type = "ground"
surface = "rigid:stone"
[[contact]]
type = "pair"
surface = "outer"
with = "rigid:load"
"""


def test_at_rest_contact_bears_the_weight(folder: Path) -> None:
    rows = _run(folder, PILE + _dynamics("240 ms", "4 ms", 'mass_damping = "80 1/s"'))
    block = 1000.0 * SIDE**3
    # exp(-80 / 2 * 0.24) = 7e-5 of the weight's sudden load is still on its way; measured 6e-5.
    for name, mass in (
        ("ground_0", block + 0.02),
        ("ground_1", 2000.0 * 0.016**3),
        ("pair_2", 0.02),
    ):
        assert rows[f"{name}_force_N"][-1] == pytest.approx(mass * G, rel=5e-4), name
    # It lies on the block, which sags by its weight: (m / 2 + load) g / (E A) H, and a little more
    # beneath a load that covers half of it only; measured 13 %.
    sag = 1e3 * (0.5 * block + 0.02) * G / (203e3 * SIDE**2) * SIDE
    assert 34.0 - rows["rigid_load_z_mm"][-1] == pytest.approx(sag, rel=0.25)
    assert abs(rows["rigid_load_turn_x_deg"][-1]) < 0.01
    # It sinks in by micrometres, see motion_parts.RIGID_MODULUS; measured 1.8.
    assert 8.0 - rows["rigid_stone_z_mm"][-1] == pytest.approx(0.002, abs=0.002)


HIT = """
[[rigid]]
name = "ball"
shape = "sphere"
radius = "8 mm"
density = "2000 kg/m^3"
position = ["-24 mm", "0 mm", "15 mm"]
velocity = ["0.5 m/s", "0 m/s", "0 m/s"]
"""
SOFT = '[[contact]]\ntype = "pair"\nsurface = "outer"\nwith = "rigid:ball"\n'
HARD = """
[[rigid]]
name = "target"
shape = "box"
size = ["10 mm", "20 mm", "20 mm"]
density = "1000 kg/m^3"
position = ["-10 mm", "0 mm", "115 mm"]
[[contact]]
type = "pair"
surface = "rigid:target"
with = "rigid:ball"
"""


@pytest.mark.parametrize("soft", [True, False])
def test_a_blow_keeps_momentum(folder: Path, soft: bool) -> None:
    text = HIT + SOFT if soft else HIT.replace('"15 mm"', '"115 mm"') + HARD
    rows = _run(folder, WEIGHTLESS + text + _dynamics("24 ms", "1 ms"))
    ball = 4.0 / 3.0 * math.pi * 0.008**3 * 2000.0
    total = ball + 1000.0 * SIDE**3 + (0.0 if soft else 4e-3)
    way = rows["centre_x_mm"] - rows["centre_x_mm"][0]
    # The centre of all masses goes on: forces are equal and opposite, so round-off, and the ten
    # digits of the file.
    np.testing.assert_allclose(way, 500.0 * ball / total * rows["time_s"], atol=1e-7)
    # They met: the ball is slower, or comes back. (Rigid bodies part within less than a row.)
    assert rows["pair_0_force_N"].max() > 0.05 or not soft
    assert rows["rigid_ball_speed_m_s"][-1] < 0.45
    # The ledger at the stable step, second order; measured 4e-3 and 3e-4.
    balance = np.abs(rows["unaccounted_J"]).max() / rows["kinetic_J"][0]
    assert balance < 1e-2
    if not soft:
        # The first body's velocity after a blow: e = 1 would give v (1 - m2/m1) / (1 + m2/m1).
        after = np.gradient(rows["rigid_target_x_mm"], rows["time_s"])[-1]
        common = 500.0 * ball / (ball + 4e-3)
        assert common < after <= 2.0 * common * (1.0 + 1e-3)


# --------------------------------------------------------------------------- tied


TIED = """
[[rigid]]
name = "payload"
shape = "box"
size = ["10 mm", "10 mm", "10 mm"]
mass = "10 g"
position = ["0 mm", "0 mm", "35 mm"]
tied = "{group}"
"""


@pytest.mark.parametrize("group", ["z1", "lid"])
def test_a_tied_body_carries_its_nodes(folder: Path, group: str) -> None:
    motion = _motion(folder, WEIGHTLESS + TIED.format(group=group) + _dynamics("2 ms"))
    model, rigid, mesh = motion.model, motion.rigid, motion.mesh
    nodes = np.unique(mesh.facet_groups["z1"] if group == "z1" else mesh.cells[48:64])
    if group == "lid":
        nodes = np.unique(mesh.cells[mesh.cell_groups["lid"]])
    assert np.array_equal(rigid.tied["payload"], nodes)
    # Nothing is lost and nothing counted twice: round-off.
    assert motion.mass == pytest.approx(1000.0 * SIDE**3 + 0.01, rel=1e-12)
    m, x = motion.body.node_mass[nodes], mesh.nodes[nodes]
    centre = (m @ x + 0.01 * np.array([0.0, 0.0, 0.035])) / (m.sum() + 0.01)
    np.testing.assert_allclose(rigid.centres[0], centre, atol=1e-15)
    # Kinetic energy of a spin about the centre, body by body: omega I omega = sum of m (w x r)^2.
    omega = np.array([1.0, -2.0, 3.0])
    own = omega @ box((0.01,) * 3, 0.01 / 1e-6)[1] @ omega
    arms = np.concatenate([x, [[0.0, 0.0, 0.035]]]) - centre
    moving = (np.append(m, 0.01) * (np.cross(omega, arms) ** 2).sum(axis=1)).sum()
    assert omega @ rigid.bodies.inertia[0] @ omega == pytest.approx(own + moving, rel=1e-12)
    # Cells that are rigid as a whole have no stiffness: of the lid all, of the surface none.
    assert len(model.soft_cells) == (48 if group == "lid" else 64)


def test_a_tied_body_hangs_on_to_the_block(folder: Path) -> None:
    text = TIED.format(group="z1") + '[gravity]\n[[contact]]\ntype = "ground"\nsurface = "outer"\n'
    rows = _run(folder, text + _dynamics("200 ms", "4 ms", 'mass_damping = "80 1/s"'))
    # As above: exp(-8) = 3e-4 of the weight is still on its way; measured 2e-4.
    weight = (1000.0 * SIDE**3 + 0.01) * G
    assert rows["ground_0_force_N"][-1] == pytest.approx(weight, rel=1e-3)
    motion = _motion(folder, text + _dynamics("2 ms"))
    assert rows["rigid_payload_z_mm"][0] == pytest.approx(35.0, abs=1e-9)
    assert motion.rigid.centres[0][2] < 0.0349  # the centre of mass is another
    assert rows["rigid_payload_z_mm"][-1] < 35.0


def test_a_start_shape_is_set_down_with_what_is_tied_to_it(folder: Path) -> None:
    text = (
        TIED.format(group="z0").replace('"35 mm"', '"-5 mm"')
        + FALLING
        + '[start]\ncase = "none"\nsettle = "2 ms"\nset_down = "4 ms"\nturn = "10 deg"\n'
        + '[[contact]]\ntype = "ground"\nsurface = ["outer", "rigid:*"]\n'
        + SOFT
        + _dynamics("2 ms")
    )
    mesh = build_mesh(load_case(str(_written(folder, HEAD + FALLING + _dynamics("2 ms")))))
    text = text.replace('case = "none"', 'case = "case.toml"')
    motion = _motion(folder, text, np.zeros_like(mesh.nodes))
    state, rigid = motion.state, motion.rigid
    # It hangs below the block, and its lowest edge is set down; it sinks in by micrometres then.
    first = motion.model.mesh_node_count
    payload = state.x[first:][rigid.owner == 0]
    assert abs(payload[:, 2].min()) < 1e-4
    assert state.x[:first, 2].min() > 5e-3
    # Loose bodies are where they were put, to the bit, and as fast as was asked.
    box_row = rigid.bodies.names.index("box")
    assert np.array_equal(state.rigid_x[box_row], [0.05, 0.0, 0.06])
    assert np.array_equal(state.rigid_v[box_row], [0.3, 0.0, 0.5])
    own = rigid.owner == box_row
    arm = state.x[first:][own] - state.rigid_x[box_row]
    speed = [0.3, 0.0, 0.5] + np.cross([0.0, 0.0, 40.0 * math.pi], arm)
    np.testing.assert_allclose(state.v[first:][own], speed, atol=1e-12)


def _written(folder: Path, text: str) -> Path:
    (folder / "case.toml").write_text(text)
    return folder / "case.toml"


def test_what_is_held_stays(folder: Path) -> None:
    text = PILE.replace(
        'name = "stone"', 'name = "stone"\nhold = ["x", "y", "z", "turn_x"]'
    ) + _dynamics("8 ms")
    rows = _run(folder, text.replace('["60 mm", "0 mm", "8 mm"]', '["60 mm", "0 mm", "30 mm"]'))
    assert set(rows["rigid_stone_z_mm"]) == {30.0}


# --------------------------------------------------------------------------- results


SPINNING = PILE + TIED.format(group="z1").replace('"35 mm"', '"60 mm"') + HIT


def test_a_killed_motion_goes_on_to_the_same_bits(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = SPINNING.replace("velocity", 'spin = ["5 rad/s", "3 rad/s", "1 rad/s"]\nvelocity')
    text += _dynamics("20 ms", "2 ms", "checkpoint = 3")
    loaded = load_case(str(_written(folder, HEAD + text)))
    run_case(loaded, folder / "whole")
    record = motion_module.Recorder.record

    def stop(self: object, state: object) -> None:
        record(self, state)  # type: ignore[arg-type]
        if state.interval == 7:  # type: ignore[attr-defined]
            raise KeyboardInterrupt

    monkeypatch.setattr(motion_module.Recorder, "record", stop)
    assert run_case(loaded, folder / "broken").status is Status.INTERRUPTED
    monkeypatch.setattr(motion_module.Recorder, "record", record)
    assert run_case(loaded, folder / "broken", resume=True).status is Status.DONE
    states = []
    for name in ("whole", "broken"):
        with h5py.File(folder / name / "checkpoint.h5") as file:
            states.append({key: np.asarray(value) for key, value in file["state"].items()})
    assert states[0].keys() == states[1].keys()
    assert "rigid_turn" in states[0]
    for key, value in states[0].items():
        assert np.array_equal(value, states[1][key], equal_nan=True), key
    for kind in ("curve.csv", "rigid.pvd"):
        one, two = ((folder / name / kind).read_text() for name in ("whole", "broken"))
        assert one == two


def test_surfaces_are_written_and_drawn(folder: Path) -> None:
    rows = _run(folder, FALLING + _dynamics("8 ms"))
    out = folder / "out"
    assert (out / "rigid.pvd").read_text().count("<DataSet") == 3
    assert len(list((out / "fields").glob("rigid_*.vtu"))) == 3
    # Where the columns say, to the single precision of the displacement.
    skin = read_rigid(out / "fields" / "rigid_0002.vtu")
    ball = skin.points[skin.points[:, 0] < 0.0]
    assert 1e3 * ball.mean(axis=0)[2] == pytest.approx(rows["rigid_ball_z_mm"][-1], abs=1e-5)
    # In one skin with the soft body, and grey whatever that shows.
    mixed = with_rigid(plots_skin.SkinReader("displacement", [])).read(
        out / "fields" / "state_0002.vtu"
    )
    assert isinstance(mixed, MixedSkin)
    soft = mixed.values[~mixed.rigid]
    assert soft.min() <= mixed.values[mixed.rigid].min() <= soft.max()
    limits = plots_skin.colour_limits([mixed])
    shown, wide, colours = painted(mixed, limits)
    assert wide[0] == limits[0]
    from matplotlib import colormaps
    from matplotlib.colors import to_hex

    scaled = (shown.values - wide[0]) / (wide[1] - wide[0])
    painted_as = {to_hex(c) for c in colormaps[colours](scaled[mixed.rigid])}
    assert painted_as == {RIGID}
    assert RIGID not in {to_hex(c) for c in colormaps[colours](scaled[~mixed.rigid])}
    # The image holds the grey of the boxes' faces, shaded, and the soft body's colours.
    frame = plots_skin.screen_axes("side")
    screen = shown.points @ frame.T
    low, high = screen.min(axis=0), screen.max(axis=0)
    image = plots_skin.draw_clear(shown, (frame, low, high, low), (300, 160), wide, colours, False)
    bodies = image[..., 3] > 250
    grey = bodies & (np.ptp(image[..., :3].astype(int), axis=2) < 25)
    assert grey.any() and (bodies & ~grey).any()


def test_a_results_folder_forgets_an_earlier_runs_surfaces(folder: Path) -> None:
    _run(folder, FALLING + _dynamics("4 ms"))
    _run(folder, "[gravity]\n" + _dynamics("4 ms"))
    assert not (folder / "out" / "rigid.pvd").exists()
    assert not list((folder / "out" / "fields").glob("rigid_*"))


def test_rotation_vector_of_small_and_large_turns() -> None:
    for angle in (0.0, 1e-9, 0.3, 3.1):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        # Near half a turn the sine is small: 1e-16 over it.
        np.testing.assert_allclose(rotation_vector(turn), [0.0, 0.0, angle], atol=1e-14)


def test_the_shipped_case(monkeypatch: pytest.MonkeyPatch) -> None:
    motion = assemble_motion(load_case("payload_drop"), None, lambda text: None)
    assert motion.model.rigid.names == ("magnet", "plate", "ball")
    bodies = 7500.0 * math.pi * 0.004**2 * 0.004 + 0.008 + 1200.0 * 4 / 3 * math.pi * 0.008**3
    assert motion.mass == pytest.approx(motion.body.node_mass.sum() + bodies, rel=1e-12)
    assert [c.name for c in motion.model.contacts] == ["ground_0", "pair_1"]


# --------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (('shape = "box"', 'shape = "cone"'), r"rigid\.load\.shape: must be"),
        (('mass = "20 g"', 'mass = "20 g"\ndensity = "1 kg/m^3"'), "exactly one of density and"),
        (('mass = "20 g"', ""), "exactly one of density and mass"),
        (('mass = "20 g"', "mass = 20"), "mass with its unit"),
        (('position = ["0 mm", "0 mm", "34 mm"]', ""), "position is missing"),
        (('size = ["20 mm", "20 mm", "8 mm"]', ""), r"a box needs size: write size ="),
        (('mass = "20 g"', 'mass = "20 g"\nradius = "1 mm"'), "a box has no radius"),
        (('mass = "20 g"', 'mass = "20 g"\naxis = "z"'), "axis belongs to a cylinder"),
        (('mass = "20 g"', 'mass = "20 g"\ngroup = "lid"'), "group stands alone"),
        (('name = "load"', ""), "name = .* is missing"),
        (('name = "load"', 'name = "a load"'), "name"),
        (('name = "load"', 'name = "stone"'), r'rigid body "stone" already'),
        (('mass = "20 g"', 'mass = "20 g"\ntied = "z9"'), r'no surface or cell group "z9"'),
        (('mass = "20 g"', 'mass = "20 g"\nturn_axis = [1, 0, 0]'), "needs a turn"),
        (('mass = "20 g"', 'mass = "20 g"\nturn = "1 deg"\nturn_axis = [0, 0, 0]'), "a length"),
        (('mass = "20 g"', 'mass = "20 g"\nmesh_size = "1 um"'), "write a larger one"),
        (('mass = "20 g"', 'mass = "20 g"\nspin = ["2 Hz", "0 Hz", "0 Hz"]'), "turn/s"),
        (
            ('mass = "20 g"', 'mass = "20 g"\nhold = "x"\nvelocity = ["1 m/s", "0 m/s", "0 m/s"]'),
            "velocity along x is held",
        ),
        (('"rigid:load"', '"rigid:box"'), 'called "rigid:box"; there is: rigid:load, rigid:stone'),
        (('type = "pair"\nsurface = "outer"', 'type = "self"\nsurface = "rigid:load"'), "with"),
    ],
)
def test_refusals(folder: Path, change: tuple[str, str], words: str) -> None:
    assert change[0] in PILE
    text = HEAD + PILE.replace(*change) + _dynamics("2 ms")
    with pytest.raises(InputError, match=words) as caught:
        loaded = load_case(str(_written(folder, text)))
        assemble_motion(loaded, None, lambda text: None)
    assert "case.toml" in str(caught.value)


def test_self_contact_is_of_the_soft_body(folder: Path) -> None:
    text = PILE + '[[contact]]\ntype = "self"\nsurface = ["outer", "rigid:load"]\n'
    with pytest.raises(InputError, match='by type = "pair"'):
        _motion(folder, text + _dynamics("2 ms"))


def test_a_static_case_has_no_rigid_bodies(folder: Path) -> None:
    with pytest.raises(InputError, match=r"only a case with \[dynamics\] has .*rigid"):
        load_case(str(_written(folder, HEAD + FALLING)))
