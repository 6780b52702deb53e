"""Install mbd_ros, with pip or with colcon."""

from pathlib import Path
from runpy import run_path

from setuptools import find_packages, setup

NAME = "mbd_ros"
SHARE = Path("share") / NAME
NODES = run_path(f"{NAME}/nodes/table.py")["NODES"]  # whose packages need not be installed yet


def shared_files() -> list[tuple[str, list[str]]]:
    """Files below `share/`: the ament marker, package.xml, launch files and configuration."""
    files = [(Path("share/ament_index/resource_index/packages"), Path("resource") / NAME)]
    files.append((SHARE, Path("package.xml")))
    for folder in ("launch", "config"):
        found = sorted(Path(folder).rglob("*"))
        files += [(SHARE / f.parent, f) for f in found if f.is_file() and f.suffix != ".pyc"]
    return [(target.as_posix(), [source.as_posix()]) for target, source in files]


setup(
    name=NAME,
    version="0.2.0",
    description="Dynamics of robots and prostheses with coupled joints, offline and live.",
    license="Apache-2.0",
    license_files=["LICENSE"],
    maintainer="mbd_ros maintainers",
    maintainer_email="mbd_ros@users.noreply.github.com",
    packages=find_packages(include=[NAME, f"{NAME}.*", "msg_adapters"]),
    package_data={
        f"{NAME}.compiled": ["*/*.c", "*/*.h"],
        f"{NAME}.nodes.shell": ["*.xml"],
        f"{NAME}.applications.report": ["*.css"],
        f"{NAME}.applications.report.precision": ["*.json"],
    },
    data_files=shared_files(),
    python_requires=">=3.10",
    install_requires=[
        "PyYAML",
        "apsw",
        "matplotlib",
        "numpy",
        "pin",
        "proxsuite",
        "qpsolvers",
        "ros-jazzy-common-interfaces",
        "ros-jazzy-rclpy",
        "ros-jazzy-rmw-fastrtps-cpp",
        "rosbags",
        "scipy",
    ],
    extras_require={
        "biomechanics": ["ezc3d"],
        "compiled": ["casadi"],
        "dask": ["dask[distributed]"],
        "docs": ["furo", "latex2mathml", "myst-parser", "pip-licenses", "sphinx"],
        "fem": ["meshio"],
        "identification": ["clarabel"],
        "learn": ["onnx", "onnxruntime", "torch"],
        "learned": ["onnxruntime"],
        "peers": ["drake", "exudyn", "mujoco", "openmm", 'opensim; python_version >= "3.11"'],
        "tables": ["pandas", "pyarrow"],
        "view": ["av", "viser"],
        "ziglang": ["ziglang"],
        "dev": [
            "av",
            "casadi",
            "clarabel",
            "daqp",
            "ezc3d",
            "meshio",
            "mypy",
            "onnx",
            "onnxruntime",
            "pandas",
            "pyarrow",
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            "quadprog",
            "ruff",
            "setuptools",
            "types-PyYAML",
            "uv",
            "viser",
        ],
    },
    entry_points={
        "console_scripts": [
            "mbd-ros = mbd_ros.programs:mbd_ros",
            *(f"{node} = {NAME}.programs:{node}" for node in NODES),
        ]
    },
)
