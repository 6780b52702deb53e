"""Particles: RATTLE and SHAKE against published vectors, rows, forces, files, bad input."""

import numpy as np
import pytest
import yaml

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError, SceneError
from mbd_ros.methods.particles.molecules import ElasticAngle, ElasticBond, Torsion
from mbd_ros.methods.particles.verlet_steps import ParticleVerlet
from mbd_ros.scene.reader import description_topic, load_scene
from mbd_ros.scene.schema.locate import embedded_scenes

SCENES = [name for name in embedded_scenes() if name.startswith("particles/")]
# Benchmark problem P01, a particle on a unit sphere, mass 1 kg, g = 9.81 m/s^2, after 10 s:
# RATTLE in multiple precision, and what velocity Verlet without projection of velocities keeps.
RATTLE_AT_10_S = {
    0.01: (
        (0.020750573897981373, 0.7779326805923579, -0.6280049029659664),
        (-1.3609744775925678, -0.9405059891833824, -1.2100086212070989),
        0.0512241209718,
    ),
    0.005: (
        (0.021576102459187015, 0.7786391902696662, -0.6271008556674671),
        (-1.3605813608578770, -0.9348993689294663, -1.2076292411477231),
        0.0256917082851,
    ),
}


def moved(scene, steps, **options):
    stepper, x = scene.stepper(**options), scene.initial
    for _ in range(steps):
        x = stepper.step(x, None)
    return x


@pytest.mark.parametrize("h", RATTLE_AT_10_S)
def test_rattle_and_shake_of_a_particle_on_a_sphere(h):
    """Positions and velocities of RATTLE, and the part of SHAKE's velocities along the normal."""
    q, v, normal = RATTLE_AT_10_S[h]
    scene, steps = mbd.load_scene("particles/sphere"), round(10 / h)
    x = moved(scene, steps, dt=h)
    assert x.q == pytest.approx(q, abs=1e-12)
    assert x.v == pytest.approx(v, abs=1e-12)
    loose = moved(scene, steps, dt=h, integrator={"type": "shake", "velocity": "unprojected"})
    assert loose.q == pytest.approx(q, abs=1e-12)
    assert loose.q.dot(loose.v) == pytest.approx(normal, abs=1e-11)
    central = moved(scene, steps, dt=h, integrator={"type": "shake"})
    assert central.q == pytest.approx(q, abs=1e-12)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_energy_of_a_million_steps_on_a_sphere():
    """P01: the largest error of the energy [J], and no drift from the first tenth to the last."""
    scene = mbd.load_scene("particles/sphere")
    system, stepper, x = scene.system(), scene.stepper(dt=0.01), scene.initial
    start, errors = system.energy(x), np.empty(1_000_000)
    for k in range(len(errors)):
        x = stepper.step(x, None)
        errors[k] = 0.5 * x.v.dot(x.v) + 9.81 * x.q[2] - start
    assert np.abs(errors).max() == pytest.approx(0.0014439425609529266, abs=1e-9)
    tenths = errors.reshape(10, -1).mean(axis=1)
    assert abs(tenths[-1] - tenths[0]) <= 1e-6
    assert abs(system.residual(0.0, x.q)[0]) <= 1e-14


@pytest.mark.parametrize("name", SCENES)
def test_an_embedded_scene_keeps_its_rows_and_its_energy(name):
    """Rows to rounding; the error of the energy is of second order in the step."""
    scene = mbd.load_scene(name)
    if len(scene.system().names) > 100:
        return
    changes = []
    for steps, dt in ((100, scene.dt), (200, scene.dt / 2)):
        samples = scene.simulate(steps * dt, dt=dt)["samples"]
        assert samples["drift.position"].max() < 1e-13 * (1.0 + np.abs(scene.initial.q).max())
        assert samples["drift.velocity"].max() < 1e-13 * (1.0 + np.abs(scene.initial.v).max())
        changes.append(np.abs(samples["energy"] - samples["energy"][0]).max())
    assert changes[1] < 0.3 * changes[0] + 1e-12


@pytest.mark.parametrize("name", SCENES)
def test_blocks_answer_as_dense_rows_do(name):
    """Multipliers, accelerations and the response of blocks against one dense KKT solve."""
    scene = mbd.load_scene(name)
    system, x = scene.system(), scene.initial
    if len(system.names) > 100:
        return
    J, force = system.jacobian(0.0, x.q), system.applied(0.0, x.q, x.v)
    step = 1e-6
    ahead, behind = (system.jacobian(0.0, x.q + s * step * x.v) for s in (1.0, -1.0))
    drift = (ahead - behind).dot(x.v) / (2.0 * step)
    M, m = system.mass(x.q).dense, len(J)
    kkt = np.block([[M, -J.T], [J, np.zeros((m, m))]])
    answer = np.linalg.solve(kkt, np.concatenate([force, -drift]))
    now = system.evaluate(x)
    scale = 1.0 + np.abs(answer).max()
    assert now.a == pytest.approx(answer[: system.nv], abs=1e-8 * scale)
    assert now.lam == pytest.approx(answer[system.nv :], abs=1e-8 * scale)
    push = np.arange(system.nv, dtype=float)
    felt = np.linalg.solve(kkt, np.concatenate([push, np.zeros(m)]))[: system.nv]
    assert now.respond(push) == pytest.approx(felt, abs=1e-10 * np.abs(push).max())


@pytest.mark.parametrize(
    "term",
    [
        ElasticBond(0, 1, 1.0, 3.0),
        ElasticAngle(0, 1, 2, 1.8, 2.0),
        Torsion((0, 1, 2, 3), (1.0, 2.0, -0.5, 0.7)),
    ],
)
def test_forces_are_slopes_of_energies(term):
    x = np.random.default_rng(3).normal(size=(4, 3, 5))
    force = np.zeros_like(x)
    term.add_force(x, force)
    for place in np.ndindex(4, 3):
        d = np.zeros_like(x)
        d[place] = 1e-6
        slope = (term.energy(x + d) - term.energy(x - d)) / 2e-6
        assert force[place] == pytest.approx(-slope, abs=2e-8)


def test_copies_are_independent_and_move_as_one_alone():
    """Each of many chains has the bits of one; another start stays another motion."""
    scene = mbd.load_scene("particles/trimer")
    many, one = scene.system().repeated(3), scene.system()
    starts = [scene.with_(initial={"temperature": 1.0, "seed": s}).initial for s in (1, 2, 3)]
    x = State(0.0, *(np.concatenate([getattr(s, f) for s in starts]) for f in "qv"))
    together, alone = ParticleVerlet(many, 1e-13, 0.05), ParticleVerlet(one, 1e-13, 0.05)
    y = starts[1]
    for _ in range(50):
        x, y = together.step(x), alone.step(y)
    assert (x.q[9:18] == y.q).all()
    assert (x.v[9:18] == y.v).all()


def test_rows_hold_where_redundant():
    """Four points with all six distances and a fifth with four: one row too many."""
    at = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]]
    names = "ABCDE"
    atoms = {n: {"mass": 1.0, "at": p} for n, p in zip(names, at, strict=True)}
    bonds = [{"between": [a, b]} for i, a in enumerate(names) for b in names[:i]]
    body = {"atoms": atoms, "bonds": bonds}
    entries = {"units": "reduced", "particles": {"molecules": {"body": body}}}
    scene = mbd.scene_from({**entries, "initial": {"temperature": 1.0}, "dt": 0.01})
    assert "degrees of freedom 6" in scene.check()
    assert "9 of 10 rows" in scene.check()
    samples = scene.simulate(1.0)["samples"]
    assert samples["drift.position"].max() < 1e-12
    assert np.ptp(samples["energy"]) < 1e-3


COORDINATES = {
    "start.gro": "title\n 2\n    1AR      A    1   0.100   0.200   0.300\n"
    "    1AR      B    2   0.200   0.200   0.300\n 1.0 1.0 1.0\n",
    "start.pdb": "ATOM      1  A   AR      1       1.000   2.000   3.000\n"
    "ATOM      2  B   AR      1       2.000   2.000   3.000\nEND\n",
    "start.xyz": "2\ntitle\nA 1.0 2.0 3.0\nB 2.0 2.0 3.0\n",
}


@pytest.mark.parametrize("name", COORDINATES)
@pytest.mark.parametrize(("units", "size"), [("molecular", 1.0), ("si", 1e-10)])
def test_positions_of_a_file_are_converted(name, units, size, tmp_path):
    (tmp_path / name).write_text(COORDINATES[name], encoding="utf-8")
    pair = dimer(size, {"file": str(tmp_path / name)})
    scene = mbd.scene_from({"units": units, "particles": {"molecules": {"pair": pair}}})
    assert scene.initial.q / size == pytest.approx([1, 2, 3, 2, 2, 3], rel=1e-12)


def test_a_molecule_that_the_box_cuts_is_whole_again(tmp_path):
    file = tmp_path / "cut.xyz"
    file.write_text("2\n\nA 9.5 2.0 3.0\nB 0.5 2.0 3.0\n", encoding="utf-8")
    pair = dimer(1.0, {"file": str(file)})
    particles = {"molecules": {"pair": pair}, "box": [10.0, 10.0, 10.0]}
    scene = mbd.scene_from({"units": "molecular", "particles": particles})
    assert scene.initial.q == pytest.approx([9.5, 2, 3, 10.5, 2, 3])
    with pytest.raises(SceneError, match="A_B of molecule 1 is 9 long.*in the order A, B"):
        mbd.scene_from({"units": "molecular", "particles": {"molecules": {"pair": pair}}})


def test_a_step_that_is_too_long_for_a_bond_is_a_warning():
    scene = mbd.load_scene("particles/dimer")
    assert "vibrate too fast" not in scene.check()
    assert "A and B of dimer vibrate too fast" in scene.with_(dt=0.5).check()


def test_arrays_of_many_particles_need_a_file_that_holds_them(tmp_path):
    scene = mbd.load_scene("particles/trimer")
    trimer = scene.entries["particles"]["molecules"]["trimer"]
    many = {"molecules": {"trimer": {**trimer, "count": 40}}}
    changed = {**scene.entries, "particles": many, "record": {"quantities": ["positions"]}}
    file = tmp_path / "many.yaml"
    file.write_text(yaml.safe_dump(changed, sort_keys=False), encoding="utf-8")
    words = ["simulate", str(file), "-t", "0.2", "-o"]
    assert main([*words, str(tmp_path / "o.csv")]) == 2
    assert main([*words, str(tmp_path / "o.npz")]) == 0
    assert mbd.read_result(tmp_path / "o.npz")["samples"]["positions"].shape == (5, 120, 3)


def dimer(size, placement=None):
    atoms = {"A": {"mass": 1.0, "at": [0, 0, 0]}, "B": {"mass": 1.0, "at": [size, 0, 0]}}
    return {"atoms": atoms, "bonds": [{"between": ["A", "B"]}], "placement": placement}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("units: reduced", "units: {length: angstrom, time: s, mass: amu}", "of two systems"),
        ("units: reduced", "units: {length: inch, time: s, mass: kg}", "unknown unit 'inch'"),
        ("units: reduced", "units: [si, molecular]", "accepted: si"),
        ("at: [1.0, 1.0, 0.0]", "at: [1.0, 0.0, 0.0]", "B and C are at the same place"),
        ("between: [B, C]}", "between: [B, D]}", "no atom 'D'"),
        ("between: [B, C]}", "between: [B, A]}", "bound twice"),
        ("between: [B, C]}", "between: [B, C]}\n        - {between: [A, C], length: 5.0}", "hold"),
        ("mass: 1.0, at: [1.0, 1.0", "mass: -1.0, at: [1.0, 1.0", "mass"),
        ("dt: 0.05", "dt: 0.0", "dt"),
        ("dt: 0.05", "gravity: [0, 0, 1]", "unknown key 'gravity'"),
        ("dt: 0.05", "integrator: {type: rk4}", "accepted: rattle, shake"),
        ("temperature: 1.0", "temperature: -1.0", "temperature"),
        ("temperature: 1.0", "velocity: {E: [0, 0, 0]}", "no such particle"),
        ("seed: 1}", "seed: 1}\nrecord: {quantities: [masses]}", "'masses'"),
        ("      bonds:", "      placement: {file: no.gro}\n      bonds:", "units of its own"),
    ],
)
def test_a_mistake_is_named(old, new, message, tmp_path):
    text = embedded_scenes()["particles/trimer"].read_text(encoding="utf-8")
    assert old in text
    scene = tmp_path / "trimer.yaml"
    scene.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(SceneError, match=".") as raised:
        mbd.load_scene(scene)
    assert message in str(raised.value)
    assert "trimer.yaml" in str(raised.value)


def test_commands_of_robots_refuse_particles(tmp_path, capsys):
    out = str(tmp_path / "o.csv")
    assert main(["simulate", "particles/trimer", "-t", "0.5", "-o", out]) == 0
    assert main(["simulate", "particles/trimer", "-t", "0.5", "-o", str(tmp_path / "bag")]) == 2
    assert "no topics" in capsys.readouterr().err
    assert main(["inverse", "particles/trimer", out, "-o", str(tmp_path / "i.csv")]) == 2
    assert "no joints" in capsys.readouterr().err


def test_a_run_that_diverges_keeps_what_it_has(tmp_path, capsys):
    out = tmp_path / "o.npz"
    words = ["simulate", "particles/trimer", "-t", "1000", "--dt", "100", "-o", str(out)]
    assert main(words) == 1
    assert "try a smaller dt" in capsys.readouterr().err
    assert mbd.read_result(tmp_path / "o.diverged.npz")["samples"].rows == 1


def test_yaml_of_the_page_builds():
    page = (embedded_scenes()["particles/trimer"].parents[3] / "docs/particles.md").read_text()
    entries = yaml.safe_load(page.split("```yaml")[1].split("```")[0])
    scene = mbd.scene_from(entries)
    assert scene.system().names[0] == "butane_1_C1"
    with pytest.raises(MbdError, match="-t"):
        scene.simulate(-1.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"fields": [{"type": "uniform", "acceleration": [1e30, 0, 0]}]}, "try a smaller dt"),
        ({"pairs": {"cutoff": 1.0}}, "no atom has a charge"),
    ],
)
def test_extreme_numbers_end_with_an_error(change, message):
    scene = mbd.load_scene("particles/trimer")
    with pytest.raises(MbdError, match=message):
        scene.with_(particles={**scene.entries["particles"], **change}).simulate(1.0)


def test_a_node_that_gets_particles_says_why_not():
    """Nodes read scenes by these two functions."""
    for read in (load_scene, description_topic):
        with pytest.raises(SceneError, match="no joints and no topics"):
            read("particles/trimer")


def test_si_units_are_the_same_motion():
    """Thresholds are multiples of lengths: a molecule of 1e-10 m moves like one of 1 angstrom."""
    molecular = mbd.load_scene("particles/butane")
    butane = molecular.entries["particles"]["molecules"]["butane"]
    energy = 1.66053906660e-27 * (1e-10 / 1e-12) ** 2
    atoms = {
        name: {"mass": 1.66053906660e-27 * one["mass"], "at": [1e-10 * x for x in one["at"]]}
        for name, one in butane["atoms"].items()
    }
    si = {
        "atoms": atoms,
        "bonds": [{**one, "length": 1e-10 * one["length"]} for one in butane["bonds"]],
        "angles": [{**one, "stiffness": energy * one["stiffness"]} for one in butane["angles"]],
        "torsions": [
            {**one, "cosines": [energy * c for c in one["cosines"]]} for one in butane["torsions"]
        ],
    }
    initial = {"temperature": 300.0, "seed": 1}
    particles = {"molecules": {"butane": si}}
    scene = mbd.scene_from({"particles": particles, "initial": initial, "dt": 2e-15})
    here, there = moved(scene, 50), moved(molecular, 50)
    assert 1e10 * here.q == pytest.approx(there.q, abs=1e-9)
    assert here.t == pytest.approx(1e-12 * there.t)
    assert "SETTLE" not in scene.check()
