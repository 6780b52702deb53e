"""The contents of `import mbd_ros`: scenes with the jobs as methods."""

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
    """A built scene with everything that is done with one, the jobs too, as methods."""

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
        """The same scene with the jobs as methods."""
        return cls(*(getattr(scene, field.name) for field in fields(scene) if field.init))

    def phased_system(self, *arguments: Any, **options: Any) -> "PhasedSystem":
        """The systems of all phases, behind one; arguments and errors as for `system`."""
        from mbd_ros.scene.phased_systems import build_phased_system

        return build_phased_system(self, *arguments, **options)

    def with_(self, numbers: Mapping[str, Any] | None = None, /, **sections: Any) -> "Scene":
        """The scene with other sections and other numbers, built as far as they change it.

        Args:
            numbers: Numbers by `<name of a part>.<argument>`, such as
                `ankle_joint_spring.stiffness`; lists of numbers too. A section of one entry, such
                as `integrator` or `initial`, goes by its key.
            **sections: As `scene_from` takes them; None removes a section.

        Raises:
            SceneError: Names key, what is wrong and what is accepted.
        """
        scene = with_sections(self, **sections) if sections or not numbers else self
        return with_numbers(scene, numbers) if numbers else scene

    def batch(self, count: int, **options: Any) -> "Batch":
        """Many runs side by side, from other starts and with other numbers.

        Args:
            **options: As for `Batch`.

        Raises:
            SceneError: Names what is wrong and what is accepted.
        """
        from mbd_ros.scene.runs.batch import Batch

        return Batch(self, count, **options)

    def check(self) -> Lines:
        """The lines of `mbd-ros check`: parts that are built and left out, and the cost of a call.

        Raises:
            MbdError: The scene has no consistent start.
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
        path: Scene file, `package://<package>/<path>`, or the name of an embedded scene, which
            `mbd-ros scenes` lists.
        allow_code: Whether the scene may import code from outside this package.

    Returns:
        A `Scene`; or a scene of particles, with the methods that these have, where the file has
        a section `particles`.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    with permitting(allow_code):
        return _with_jobs(reader.load_any(path))


def _with_jobs(scene: Any) -> Any:
    """A scene with the jobs as methods."""
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
        entries: Sections as a scene file has them; numpy arrays and tuples stand for lists, a
            class for its name where a `type` is asked for.
        urdf: The robot: a file, `package://<package>/<path>`, the name of an embedded robot such
            as `arm7`, or URDF text.
        allow_code: Whether `type` may name code from outside this package.

    Returns:
        As for `load_scene`.

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    with permitting(allow_code):
        if urdf is None and reader.has_particles(entries or {}):
            given = from_python.plain(entries, Origin().name)
            return _with_jobs(reader.build_any(Origin(), given))
        return Scene.of(from_python.scene_from(entries, urdf=urdf))


def read_robot(urdf: str | Path) -> Robot:
    """The robot of a description, checked.

    Args:
        urdf: As `scene_from` takes it.

    Raises:
        SceneError: Names what is wrong and what is accepted.
    """
    robot: Robot = scene_from(urdf=urdf).robot
    return robot
