"""Learning with torch: what it finds, what it leaves alone, and few trials of something new."""

import numpy as np
import pytest
from worn_leg import LEG, worn_leg

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.features.identification.learn.job import write_folder
from mbd_ros.features.identification.learn.weights_file import read_folder

pytest.importorskip("torch", reason="torch is optional and large (extra: learn)")
pytest.importorskip("onnx", reason="onnx is optional (extra: learn)")
pytest.importorskip("onnxruntime", reason="onnxruntime is optional (extra: learned)")
WALK = {"amplitude": (0.35, 0.5, 0.2), "middle": (0.05, -0.5, 0.0), "period": (0.9, 1.5)}
RUN = {"amplitude": (0.5, 0.75, 0.3), "middle": (0.1, -0.7, 0.0), "period": (0.62, 0.75)}
HARMONICS = ((1.0, 0.9, 0.0), (0.35, 0.7, 1.3), (0.12, 2.0, 0.0))
NOISE = (2.8, 1.3, 0.3)  # N·m: 5 % of the torques of walking


def stride(random, kind, count=40, noise=1.0):
    """A stride with its torques, as a recording; positions of three harmonics."""
    true = worn_leg(0.05)
    period, scatter = random.uniform(*kind["period"]), 0.1 if kind is RUN else 0.2
    t = np.arange(count) / count * period
    q, v, a = np.zeros((3, count, 3))
    for j in range(3):
        q[:, j] = kind["middle"][j]
        for h, (share, shift, phase) in enumerate(HARMONICS, 1):
            A = kind["amplitude"][j] * share * (1.0 + scatter * random.normal())
            p, w = shift * j + phase + 0.15 * random.normal(), 2.0 * np.pi * h / period
            q[:, j] += A * np.sin(w * t + p)
            v[:, j] += A * w * np.cos(w * t + p)
            a[:, j] -= A * w * w * np.sin(w * t + p)
    tau = true.inverse_dynamics().batch(q, v, a).tau
    tau = tau + noise * np.array(NOISE) * random.normal(size=tau.shape)
    columns = [mbd.Column("time", t, "s")]
    for j, name in enumerate(true.couplings.independent):
        for key, unit, values in (
            ("position", "rad", q), ("velocity", "rad/s", v),
            ("acceleration", "rad/s^2", a), ("effort", "N·m", tau),
        ):  # fmt: skip
            columns.append(mbd.Column(f"{name}.{key}", values[:, j], unit))
    return mbd.Result({"samples": mbd.Table(columns)})


def error(folder, trials):
    """Share of the torque of strides that a written scene does not explain."""
    scene, left, whole = mbd.load_scene(folder / "scene.yaml"), 0.0, 0.0
    names = scene.couplings.independent
    for trial in trials:
        table = trial["samples"]
        q, v, a, tau = (
            np.column_stack([table[f"{n}.{key}"] for n in names])
            for key in ("position", "velocity", "acceleration", "effort")
        )
        left += np.sum(np.square(scene.inverse_dynamics().batch(q, v, a).tau - tau))
        whole += np.sum(np.square(tau))
    return float(np.sqrt(left / whole))


def written(folder, trials):
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for i, trial in enumerate(trials):
        paths.append(str(folder / f"trial{i}.csv"))
        trial.to(paths[-1])
    return paths


def learned(out, *words, scene=LEG):
    said = ["learn", str(scene), *words, "--physics", "given", "--learned", "1", "-o", str(out)]
    assert main([*said, "--variant", "structured", "--members", "2"]) == 0
    return out


def test_friction_and_a_payload_are_learned_and_adapted_from_a_trial(tmp_path):
    """Through files and commands; a model goes on from its own folder."""
    random = np.random.default_rng(0)
    walk = written(tmp_path / "walk", [stride(random, WALK) for _ in range(4)])
    run = written(tmp_path / "run", [stride(random, RUN)])
    test = [stride(random, WALK, noise=0.0)]
    model = learned(tmp_path / "model", *walk, "--steps", "150")
    plain = tmp_path / "plain"
    plain.mkdir()
    (plain / "scene.yaml").write_text((model / "scene.yaml").read_text().split("forces:")[0])
    (plain / "robot.urdf").write_bytes((model / "robot.urdf").read_bytes())
    assert error(model, test) < 0.3 * error(plain, test)
    words = ("--start", str(model), "--steps", "20", "--freeze", "all-but", "adapters")
    adapted = learned(tmp_path / "adapted", *words, *run, scene=model / "scene.yaml")
    running = [stride(random, RUN, noise=0.0)]
    assert error(adapted, running) < min(0.015, 0.1 * error(model, running))
    before, after = read_folder(model), read_folder(adapted)
    assert all(np.array_equal(before.weights[key], after.weights[key]) for key in before.weights)
    assert (adapted / "robot.urdf").read_bytes() == (model / "robot.urdf").read_bytes()
    assert (after.about.low <= before.about.low).all()


def test_a_model_goes_on_from_the_scene_that_was_identified(tmp_path, capsys):
    """Whether that is named, or the one that it was identified from."""
    random = np.random.default_rng(3)
    walk = written(tmp_path / "walk", [stride(random, WALK) for _ in range(3)])
    run = written(tmp_path / "run", [stride(random, RUN)])
    few = ["--members", "2", "--steps", "5", "--learned", "1"]
    start = tmp_path / "start"
    assert main(["learn", LEG, *walk, *few, "-o", str(start)]) == 0
    adapted = []
    for scene in (start / "scene.yaml", LEG):
        out = tmp_path / f"out{len(adapted)}"
        words = ["--start", str(start), "--freeze", "all-but", "adapters"]
        assert main(["learn", str(scene), *run, *few, *words, "-o", str(out)]) == 0
        adapted.append((out / "robot.urdf").read_bytes() + (out / "scene.yaml").read_bytes())
    assert adapted[0] == adapted[1]
    assert f"as it was identified: {start / 'scene.yaml'}" in capsys.readouterr().out
    heavy = mbd.load_scene(LEG).with_inertias({"foot": (2.0, [0.0, 0.0, -0.05], 0.01 * np.eye(3))})
    with pytest.raises(mbd.MbdError, match="--start was learned on .* another inertia"):
        heavy.learn(*run, start=read_folder(start), learned=1.0, freeze="all-but adapters")


def test_noise_is_not_learned(tmp_path):
    """Where physics explains everything but noise, no joint gets a network."""
    leg, random = mbd.load_scene(LEG), np.random.default_rng(1)
    t = np.arange(0.0, 6.0, 0.02)
    columns = [mbd.Column("time", t, "s")]
    for i, name in enumerate(leg.couplings.independent):
        angle = 0.3 * np.sin((2.0 + i) * t) - 0.4 * (name == "knee")
        columns.append(mbd.Column(f"{name}.position", angle, "rad"))
    exact = leg.inverse(mbd.Result({"samples": mbd.Table(columns)}), derivatives="zero-phase")
    table = exact["samples"]
    noisy = [
        c._replace(values=c.values + 0.5 * random.normal(size=len(t)))
        if c.name.endswith(".effort") else c
        for c in table.columns
    ]  # fmt: skip
    recording = mbd.Result({"samples": mbd.Table(noisy)})
    found = leg.learn(recording, physics="given", members=3, steps=60)
    assert not found.model.trust.any()
    assert found.errors["learned"] == found.errors["physics"]
    assert any("it gives 0" in line for line in found.remarks)


def test_errors_are_those_of_the_model_that_is_written(tmp_path):
    """It fades where running leaves the range of walking, and so do the errors that are said."""
    random, leg = np.random.default_rng(6), mbd.load_scene(LEG)
    tables = [stride(random, kind, noise=0.0)["samples"] for kind in (WALK, WALK, RUN)]
    columns = []
    for column in tables[0].columns:
        values = [table[column.name] for table in tables]
        if column.name == "time":
            values = [one + 10.0 * i for i, one in enumerate(values)]
        columns.append(column._replace(values=np.concatenate(values)))
    recording = mbd.Result({"samples": mbd.Table(columns)})
    found = leg.learn(recording, physics="given", learned=0.6, members=2, steps=40)
    write_folder(tmp_path, found, {}, lambda line: None)
    said = [error(tmp_path, [mbd.Result({"samples": tables[2]})]), found.errors["learned"]]
    assert said[0] == pytest.approx(said[1], rel=1e-9)
    assert found.model.trust.max() > 0.0 and said[1] != pytest.approx(found.errors["physics"])


def test_the_comparison_of_a_slow_recording(tmp_path):
    """30 Hz: half a second is too little and left out, a second keeps its ends."""
    leg, t = mbd.load_scene(LEG), np.arange(0.0, 6.0, 1.0 / 30.0)
    columns = [mbd.Column("time", t, "s")]
    for i, name in enumerate(leg.couplings.independent):
        angle = 0.3 * np.sin((2.0 + i) * t) - 0.4 * (name == "knee")
        columns.append(mbd.Column(f"{name}.position", angle, "rad"))
    motion = mbd.Result({"samples": mbd.Table(columns)})
    leg.inverse(motion, derivatives="zero-phase").to(tmp_path / "slow.csv")
    words = ["learn", LEG, str(tmp_path / "slow.csv"), "--derivatives", "zero-phase"]
    words += ["--compare", "--seeds", "1", "--steps", "2", "--members", "2"]
    assert main([*words, "-o", str(tmp_path / "out")]) == 0
    rows = (tmp_path / "out" / "comparison.csv").read_text().splitlines()[1:]
    assert sorted({float(row.split(",")[1]) for row in rows})[:3] == [1.0, 2.0, 3.0]


GIVEN = ["--physics", "given"]
LAGRANGIAN = [*GIVEN, "--learned", "1", "--variant", "structured", "--members", "2"]


@pytest.mark.soak
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(
    "words", [LAGRANGIAN, GIVEN, []], ids=["lagrangian", "given", "identified"]
)
def test_adapters_beat_all_weights_and_nothing_from_few_trials(tmp_path, words):
    """Ten legs that have learned walking, few strides of running; errors on six others.

    With a Lagrangian network, and with default options on the leg as described and identified.
    """
    wins, rows = {1: 0, 2: 0, 5: 0}, []
    for seed in range(10):
        random, place = np.random.default_rng(100 + seed), tmp_path / str(seed)
        walk = written(place / "walk", [stride(random, WALK) for _ in range(12)])
        run = written(place / "run", [stride(random, RUN) for _ in range(5)])
        test = [stride(random, RUN, noise=0.0) for _ in range(6)]

        def made(name, *more, at=place, seed=seed):
            out = at / name
            told = ["learn", *more, *words, "--seed", str(seed), "-o", str(out)]
            assert main(told) == 0
            return out

        start = made("start", LEG, *walk)
        adapted = (str(start / "scene.yaml"), "--start", str(start), "--freeze")
        for trials in wins:
            adapters, full, nothing = (
                error(made(f"{name}{trials}", *way, *after, *run[:trials]), test)
                for name, way, after in (
                    ("a", adapted, ("all-but", "adapters")),
                    ("f", adapted, ("physics",)),
                    ("n", (LEG,), ()),
                )
            )
            rows.append((seed, trials, adapters, full, nothing))
            wins[trials] += adapters < min(full, nothing)
    assert wins[1] >= 9 and wins[2] >= 9, (wins, rows)


def test_a_model_of_other_joints_is_not_adapted(tmp_path):
    leg, random = mbd.load_scene(LEG), np.random.default_rng(0)
    found = leg.learn(stride(random, WALK), physics="given", learned=1.0, members=2, steps=2)
    other = found.model._replace(about=found.model.about._replace(joints=("knee", "ankle")))
    with pytest.raises(DataError, match="the model has joints knee, ankle"):
        leg.learn(stride(random, RUN), physics="given", learned=1.0, start=other)
