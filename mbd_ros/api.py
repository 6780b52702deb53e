"""Public Python interface: load or build a scene, and run every job as one of its methods."""

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mbd_ros.core.model.robot import Robot
from mbd_ros.features.control.job import follow
from mbd_ros.features.dirac_brackets.job import bracket
from mbd_ros.features.estimation.job import estimate
from mbd_ros.features.gait.job import gait
from mbd_ros.features.identification.excite.job import excite
from mbd_ros.features.identification.job import identify
from mbd_ros.features.identification.learn.job import learn
from mbd_ros.features.identification.payload.job import payload
from mbd_ros.features.inverse_dynamics.job import inverse
from mbd_ros.features.loads.job import loads
from mbd_ros.features.markers.job import kinematics
from mbd_ros.features.muscles.job import muscles
from mbd_ros.features.muscles.moment_arms.job import moment_arms
from mbd_ros.features.prediction.job import predict
from mbd_ros.features.sampling.job import sample
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.table import read_result as read_result
from mbd_ros.scene import built_scene, from_python, reader
from mbd_ros.scene.describe.scene_summary import Lines, scene_html, scene_text
from mbd_ros.scene.origin import Origin
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.schema.code_permission import permitting
from mbd_ros.scene.variants import with_inertias, with_numbers, with_sections

if TYPE_CHECKING:
    from mbd_ros.core.dynamics.phased_system import PhasedSystem
    from mbd_ros.scene.runs.batch import Batch


class Scene(built_scene.Scene):
    """A built scene of robots and bodies, with every job (simulate, inverse, ...) as a method.

    `load_scene` and `scene_from` return it. A scene never changes: methods such as `with_` return
    a new one.
    """

    simulation = build_simulation
    with_inertias = with_inertias
    simulate = simulate
    inverse = inverse
    identify = identify
    payload = payload
    learn = learn
    excite = excite
    kinematics = kinematics
    loads = loads
    moment_arms = moment_arms
    muscle_forces = muscles
    estimate = estimate
    gait = gait
    sample = sample
    bracket = bracket
    follow = follow
    predict = predict

    @classmethod
    def of(cls, scene: built_scene.Scene) -> "Scene":
        """Return the same scene with the jobs as methods."""
        return cls(*(getattr(scene, field.name) for field in fields(scene) if field.init))

    def phased_system(self, *arguments: Any, **options: Any) -> "PhasedSystem":
        """Build one system that switches between the systems of all phases of the scene.

        Arguments and errors are those of `system`.
        """
        from mbd_ros.scene.phased_systems import build_phased_system

        return build_phased_system(self, *arguments, **options)

    def with_(self, numbers: Mapping[str, Any] | None = None, /, **sections: Any) -> "Scene":
        """Return a copy of the scene with other sections and numbers.

        Args:
            numbers: New values by `<name of a part>.<argument>`, such as
                `ankle_joint_spring.stiffness`; a value is a number or a list of numbers. For a
                section that has one entry, such as `integrator` or `initial`, use the name of the
                section instead of the name of a part.
            **sections: New sections, written as for `scene_from`; None removes a section.

        Raises:
            SceneError: A key or value is not accepted; the message names it and what is.
        """
        scene = with_sections(self, **sections) if sections or not numbers else self
        return with_numbers(scene, numbers) if numbers else scene

    def batch(self, count: int, **options: Any) -> "Batch":
        """Return a batch that simulates many variants of the scene side by side.

        Args:
            count: Number of runs.
            **options: Initial states and numbers of the runs, as `Batch` takes them.

        Raises:
            SceneError: The scene cannot run in a batch, or an option is not accepted.
        """
        from mbd_ros.scene.runs.batch import Batch

        return Batch(self, count, **options)

    def check(self) -> Lines:
        """Return the report of `mbd-ros check`: the parts that are built, the cost of a call.

        Raises:
            MbdError: The scene has no consistent initial state.
        """
        from mbd_ros.scene.describe.check import describe

        return Lines("\n".join(describe(self)))

    def __repr__(self) -> str:
        return scene_text(self)

    def _repr_html_(self) -> str:
        return scene_html(self)


def load_scene(path: str | Path, *, allow_code: bool = False) -> Any:
    """Read and build a scene.

    Args:
        path: Scene file, `package://<package>/<path>`, or the name of an embedded scene;
            `mbd-ros scenes` lists these names.
        allow_code: Whether the scene may import code from outside this package.

    Returns:
        A `Scene`, or a `ParticleScene` if the file has a section `particles`.

    Raises:
        SceneError: The file cannot be read, or an entry is not accepted; the message names file,
            key and accepted values.
    """
    with permitting(allow_code):
        return _with_jobs(reader.load_any(path))


def _with_jobs(scene: Any) -> Any:
    """Return the scene with the jobs as methods."""
    if not reader.is_of_particles(scene):
        return Scene.of(scene)
    from mbd_ros.particle_api import ParticleScene

    return ParticleScene.of(scene)


def scene_from(
    entries: Mapping[str, Any] | None = None,
    *,
    urdf: str | Path | None = None,
    allow_code: bool = False,
) -> Any:
    """Build a scene from Python values instead of a file.

    Args:
        entries: Sections of a scene, with the keys of a scene file. Lists may be numpy arrays or
            tuples, and a `type` may be a class instead of its name.
        urdf: The robot as a URDF file, `package://<package>/<path>`, the name of an embedded
            robot such as `arm7`, or URDF text.
        allow_code: Whether `type` may name code from outside this package.

    Returns:
        A `Scene`, or a `ParticleScene` if there is a section `particles`.

    Raises:
        SceneError: An entry is not accepted; the message names its key and accepted values.
    """
    with permitting(allow_code):
        if urdf is None and reader.has_particles(entries or {}):
            sections = from_python.plain(entries, Origin().name)
            return _with_jobs(reader.build_any(Origin(), sections))
        return Scene.of(from_python.scene_from(entries, urdf=urdf))


def read_robot(urdf: str | Path) -> Robot:
    """Read a robot from its description and check its joints and inertias.

    Args:
        urdf: The robot, as for `scene_from`.

    Raises:
        SceneError: The description cannot be read, or a link or joint is not valid.
    """
    robot: Robot = scene_from(urdf=urdf).robot
    return robot
