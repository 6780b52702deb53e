"""Rigid water: SETTLE, its kinetic partition, pair forces and their energy over time."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.compiled.particles.molecule_steps import CompiledTriangles
from mbd_ros.compiled.particles.pair_kernel import CompiledKernel
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.rigid_bonds import Cluster
from mbd_ros.methods.particles.settle import SettledCluster
from mbd_ros.scene.particles.neighbour_tree import near_pairs

# Benchmark problem P02: rigid SPC/E water in angstrom, ps and amu.
BEFORE = [
    [-0.06460892772268777, 0.0, 0.0],
    [0.5127500387928425, 0.8164904309201172, 0.0],
    [0.5127500387928425, -0.8164904309201172, 0.0],
]
LOOSE = [
    [-0.053608927722687764, -0.007, 0.004],
    [0.5477500387928426, 0.8374904309201172, -0.043],
    [0.48575003879284256, -0.7854904309201172, 0.052],
]
CLOSED = [
    [-0.05438979327109508, -0.0027456517316398316, 0.004],
    [0.5300722815871072, 0.8073130393842849, -0.043],
    [0.5158220224422169, -0.8228398446271438, 0.052],
]
AFTER_1_PS = [
    [0.24098013876959865, -0.21954098931486474, 0.11758178769113088],
    [0.6155465699747438, 0.6950739417523928, 0.2698299945215467],
    [0.9212414932888311, -0.7849111397243702, -0.3488955242690461],
]
ERROR_OF_RATTLE = {0.0005: 0.0003250436989652994, 0.002: 0.005196021529635997}


def water(**changes):
    """One SPC/E molecule, free."""
    scene = mbd.load_scene("particles/water_spce")
    particles = scene.entries["particles"]
    molecule = {**particles["molecules"]["water"], "count": 1, "placement": None, **changes}
    spin, drift = np.array([10.0, 20.0, 5.0]), [0.3, -0.2, 0.1]
    names = ("O", "H1", "H2")
    initial = {
        "position": dict(zip(names, BEFORE, strict=True)),
        "velocity": {n: np.cross(spin, r) + drift for n, r in zip(names, BEFORE, strict=True)},
    }
    sections = {"particles": {"molecules": {"water": molecule}}, "initial": initial}
    return scene.with_(**sections)


def lanes(positions):
    return np.array(positions)[:, :, None].copy()


def test_settle_finds_the_published_place():
    (cluster,) = water().system().kinds[0].clusters
    assert isinstance(cluster, SettledCluster)
    moved = lanes(LOOSE)
    cluster.close(lanes(BEFORE), moved, np.zeros((3, 3, 1)), 1.0, 1e-13)
    assert moved[:, :, 0] == pytest.approx(np.array(CLOSED), abs=1e-14)


def turned(count, seed):
    """Many molecules in all directions, velocities on their rows, and both solvers."""
    kind = water().system().kinds[0]
    settled, rng = kind.clusters[0], np.random.default_rng(seed)
    turns = np.linalg.qr(rng.normal(size=(count, 3, 3)))[0]
    x = np.einsum("nij,aj->ain", turns, kind.at)
    v = rng.normal(size=x.shape) * np.sqrt(0.8314 * 300 / kind.masses)[:, None, None]
    return Cluster(settled.rows, kind.masses, kind.at), settled, x, v


def test_settle_equals_rattle():
    newton, settled, x, v = turned(2000, 1)
    results = []
    for solver in (newton, settled):
        w = v.copy()
        solver.project(x, w)
        moved = x + 0.002 * w
        after = w.copy()
        solver.close(x, moved, after, 0.002, 1e-13)
        results.append((w, moved, after))
    (w, moved, after), (w_settled, moved_settled, after_settled) = results
    assert w_settled == pytest.approx(w, abs=1e-12)
    assert moved_settled == pytest.approx(moved, abs=1e-12)
    assert after_settled == pytest.approx(after, abs=1e-12 * np.abs(v).max())


def test_settle_takes_the_smallest_multipliers():
    """Against all solutions that Newton's method finds from 200 starts, for large steps."""
    newton, settled, x, v = turned(12, 2)
    moved = x + 0.01 * v
    loose, h = moved.copy(), np.zeros_like(v)
    settled.close(x, moved, h, 1.0, 1e-13)
    D = np.array(newton.directions(x))
    least = np.linalg.norm(
        np.array([multipliers(D[..., i], h[..., i]) for i in range(12)]), axis=1
    )
    rng, found = np.random.default_rng(3), 0
    for _ in range(200):
        start = rng.normal(size=(3, 12)) * rng.choice([1.0, 5.0, 20.0])
        for i, lam in enumerate(start.T):
            other = newton_root(newton, x[..., i], loose[..., i], lam)
            if other is not None:
                found += np.linalg.norm(other) > 1.01 * least[i]
                assert np.linalg.norm(other) >= (1.0 - 1e-6) * least[i]
    assert found > 12  # there are other solutions


def multipliers(D, shift):
    """lam of M shift = J' lam, directions D of the rows O_H1, O_H2, H1_H2."""
    J = np.zeros((3, 9))
    for row, (i, j) in enumerate(((0, 1), (0, 2), (1, 2))):
        J[row, 3 * i : 3 * i + 3], J[row, 3 * j : 3 * j + 3] = D[row], -D[row]
    masses = np.repeat([15.9994, 1.008, 1.008], 3)
    return np.linalg.lstsq(J.T, masses * shift.ravel(), rcond=None)[0]


def newton_root(cluster, x, loose, lam):
    """Multipliers of a solution near a start, None where the iteration goes astray."""
    D = cluster.directions(x[:, :, None])
    for _ in range(60):
        moved = loose[:, :, None].copy()
        cluster._push(moved, D, lam[:, None])
        g = cluster.residual(moved)[:, 0]
        if np.abs(g).max() < 1e-12:
            return lam
        slope = cluster._metric(cluster.directions(moved), D)[:, :, 0]
        lam = lam - np.linalg.solve(slope, g)
        if not np.abs(lam).max() < 1e4:
            return None
    return None


@pytest.mark.parametrize("h", ERROR_OF_RATTLE)
@pytest.mark.parametrize("solver", ["plain", "compiled"])
def test_free_rotation_is_of_second_order(h, solver):
    """The error after 1 ps is that of RATTLE in multiple precision."""
    scene = water().with_(solver={"type": solver})
    x = scene.stepper(dt=h).advance(scene.initial, 1.0)
    error = np.abs(x.q - np.ravel(AFTER_1_PS)).max()
    assert error == pytest.approx(ERROR_OF_RATTLE[h], rel=1e-6)
    assert np.abs(scene.system().residual(0.0, x.q)).max() < 1e-14


@pytest.mark.parametrize(
    ("angles", "freedom", "shares"),
    [
        ([{"between": ["H1", "O", "H2"]}], 6, (1.4053016807551146, 0.7973491596224427)),
        (None, 7, (1.4410989516698427, 1.0294505241650787)),
    ],
)
def test_kinetic_energy_is_shared_as_it_must_be(angles, freedom, shares):
    """<m v^2 / 2> / kT of each atom, from the mobility of the rows."""
    angle = [{**one, "angle": np.deg2rad(109.47)} for one in angles or ()]
    scene = water(angles=angle)
    mobility = scene.system().evaluate(scene.initial).respond(np.eye(9))
    of_atoms = (0.5 * np.diag(mobility) * np.repeat(scene.system().masses, 3)).reshape(3, 3)
    assert of_atoms.sum(axis=1) == pytest.approx([shares[0], shares[1], shares[1]], abs=1e-12)
    assert of_atoms.sum() == pytest.approx(0.5 * freedom, abs=1e-12)


@pytest.fixture(scope="module")
def box():
    return mbd.load_scene("particles/water_spce")


def test_forces_of_pairs_against_a_sum_over_all(box):
    """Plain and native forces and energies, with the energy summed pair by pair in the open."""
    system, model = box.system(), box.system().pairs.model
    x = box.initial.q.reshape(-1, 3)
    oxygen, charge = np.arange(648) % 3 == 0, np.tile([-0.8476, 0.4238, 0.4238], 216)
    d = x[:, None] - x
    d -= 18.644 * np.rint(d / 18.644)
    r = np.linalg.norm(d, axis=2)
    i, j = np.nonzero((r < 9.0) & (np.arange(648)[:, None] // 3 < np.arange(648) // 3))
    r = r[i, j]
    coulomb = 138935.457644 * charge[i] * charge[j] * (1 / r + r**2 / 1458.0 - 1.5 / 9.0)

    def lj(r):
        return 260.0 * ((3.166 / r) ** 12 - (3.166 / r) ** 6)

    slope = (lj(9.0 + 1e-5) - lj(9.0 - 1e-5)) / 2e-5
    of_lj = (lj(r) - lj(9.0) - (r - 9.0) * slope)[oxygen[i] & oxygen[j]]
    expected = coulomb.sum() + of_lj.sum()
    for kernel in (system.pairs.kernel, CompiledKernel(model)):
        pairs = system.pairs.with_kernel(kernel)
        force = np.zeros((648, 3))
        assert pairs.add_force(x, force) == pytest.approx(expected, rel=1e-9)
        for place in ((0, 0), (100, 1), (647, 2)):
            step = np.zeros_like(x)
            step[place] = 1e-5
            spare = np.zeros_like(x)
            ahead, behind = (pairs.add_force(x + s * step, spare) for s in (1.0, -1.0))
            assert force[place] == pytest.approx((behind - ahead) / 2e-5, abs=1e-2)


@pytest.mark.parametrize("reach", [9.0, 12.0])
def test_no_near_pair_is_left_out(box, reach):
    x = box.initial.q.reshape(-1, 3) + 30.0
    d = x[:, None] - x
    d -= 18.644 * np.rint(d / 18.644)
    i, j = np.nonzero(np.triu(np.linalg.norm(d, axis=2) <= reach, 1))
    assert (near_pairs(x, np.full(3, 18.644), reach) == np.column_stack((i, j))).all()


def test_native_steps_are_the_plain_ones(box):
    """The same motion for 20 steps, and the same bits from a copy of the state."""
    native = box.with_(solver={"type": "compiled"})
    plain = box.stepper().advance(box.initial, 0.02)
    fast = native.stepper().advance(native.initial, 0.02)
    assert fast.q == pytest.approx(plain.q, abs=1e-9)
    assert fast.v == pytest.approx(plain.v, abs=1e-7)
    half = native.stepper().advance(native.initial, 0.01)
    again = native.stepper().advance(half._replace(q=half.q.copy()), 0.02)
    assert (again.q == fast.q).all()
    assert "native" in native.check()
    assert isinstance(native.stepper()._steps[0], CompiledTriangles)


def test_copies_have_no_pairs(box):
    assert isinstance(box.system().repeated(2), ParticleSystem)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"box": [16.0, 18.0, 18.0]}, "half the shortest edge"),
        ({"pairs": {"cutoff": 9.0, "coulomb": "ewald"}}, "expected one of reaction_field"),
        ({"box": [0.0, 18.0, 18.0]}, "must be > 0"),
    ],
)
def test_a_mistake_is_named(box, change, message):
    particles = {**box.entries["particles"], **change}
    with pytest.raises(mbd.MbdError, match=message):
        box.with_(particles=particles)


def test_overlap_is_named(box):
    positions = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5]]
    molecule = box.entries["particles"]["molecules"]["water"]
    two = {**molecule, "count": 2, "placement": {"positions": positions}}
    particles = {**box.entries["particles"], "molecules": {"water": two}}
    with pytest.raises(mbd.MbdError, match=r"water_1_\w+ and water_2_\w+ are .* apart"):
        box.with_(particles=particles)


@pytest.mark.soak
@pytest.mark.parametrize("name", ["water_spce", "water_tip3p"])
def test_energy_of_216_molecules_for_100_ps(name):
    """Slope of a straight line through the energy, times 100 ps, over the kinetic energy.

    An independent code has -1.1e-4 +- 1.0e-4 for SPC/E (benchmark problem P02).
    """
    scene = mbd.load_scene(f"particles/{name}").with_(solver={"type": "compiled"})
    samples = scene.simulate(100.0)["samples"]
    slope = np.polyfit(samples["time"], samples["energy"], 1)[0]
    assert abs(slope * 100.0 / samples["energy.kinetic"].mean()) < 5e-4
    assert samples["drift.position"].max() < 1e-12


def test_a_site_without_mass_carries_a_charge(box):
    """TIP4P: forces are slopes of the energy, and the site is where it belongs."""
    molecule = box.entries["particles"]["molecules"]["water"]
    atoms = {name: {**one, "charge": 0.52} for name, one in molecule["atoms"].items()}
    atoms["O"] = {**atoms["O"], "charge": 0.0, "sigma": 3.154, "epsilon": 64.85}
    arm = 0.15 / (0.9572 * np.cos(np.deg2rad(52.26)))  # O to M over O to the middle of H1 and H2
    site = {"charge": -1.04, "weights": {"O": 1.0 - arm, "H1": 0.5 * arm, "H2": 0.5 * arm}}
    water = {**molecule, "atoms": atoms, "sites": {"M": site}}
    particles = {**box.entries["particles"], "molecules": {"water": water}}
    scene = box.with_(particles=particles, solver={"type": "compiled"})
    system, x = scene.system(), scene.initial.q.reshape(-1, 3)
    force = np.zeros_like(x)
    system.pairs.add_force(x, force)
    for place in ((0, 0), (100, 1), (647, 2)):
        step, spare = np.zeros_like(x), np.zeros_like(x)
        step[place] = 1e-5
        ahead, behind = (system.pairs.add_force(x + s * step, spare) for s in (1.0, -1.0))
        assert force[place] == pytest.approx((behind - ahead) / 2e-5, abs=1e-2)
    assert np.abs(force.sum(axis=0)).max() < 1e-6
    sites = system.pairs.sites.with_sites(x)[648:]
    middle = 0.5 * (x[1::3] + x[2::3])
    assert sites == pytest.approx(x[::3] + arm * (middle - x[::3]), abs=1e-12)
