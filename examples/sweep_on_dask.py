"""A sweep on Dask: how the damping of a hinge changes how far a pendulum swings."""

from dask.distributed import Client

import mbd_ros as mbd


def swing_left(damping: float) -> float:
    """How far the pendulum still swings in the fifth second [rad]."""
    scene = mbd.load_scene("empty").with_(
        forces=[{"type": "joint_spring", "joint": "hinge", "stiffness": 0.0, "damping": damping}],
        initial={"position": {"hinge": 1.0}},
    )
    table = scene.simulate(5.0)["samples"]
    return float(abs(table["hinge.position"][table["time"] >= 4.0]).max())


if __name__ == "__main__":
    dampings = [0.0, 0.01, 0.02, 0.05]
    with Client(n_workers=2, threads_per_worker=1, dashboard_address=None) as client:
        swings = client.gather(client.map(swing_left, dampings))
    for damping, swing in zip(dampings, swings, strict=True):
        print(f"damping {damping:.2f} N m s/rad: {swing:.3f} rad")
