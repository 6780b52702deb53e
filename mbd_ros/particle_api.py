"""A scene of particles with the jobs as methods."""

from typing import Any

from mbd_ros.features.dirac_brackets.job import bracket
from mbd_ros.features.sampling.job import sample
from mbd_ros.features.simulation.particles import simulate
from mbd_ros.scene.describe.scene_summary import Lines
from mbd_ros.scene.particles import particle_scene
from mbd_ros.scene.variants import with_sections


class ParticleScene(particle_scene.ParticleScene):
    """A built scene of particles, which runs jobs."""

    simulate = simulate
    sample = sample
    bracket = bracket

    @classmethod
    def of(cls, scene: particle_scene.ParticleScene) -> "ParticleScene":
        """The same scene with the jobs as methods."""
        return cls(scene.origin, scene.parts, scene.entries)

    def with_(self, **sections: Any) -> "ParticleScene":
        """The scene with other sections; None removes one.

        Raises:
            SceneError: Names key, what is wrong and what is accepted.
        """
        return with_sections(self, **sections)

    def check(self) -> Lines:
        """The lines of `mbd-ros check`.

        Raises:
            MbdError: The scene has no start from which it can move.
        """
        from mbd_ros.scene.describe.particles import describe

        return Lines("\n".join(describe(self)))
