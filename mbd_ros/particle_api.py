"""Public Python interface of particle scenes: the jobs as methods of the scene."""

from typing import Any

from mbd_ros.features.dirac_brackets.job import bracket
from mbd_ros.features.sampling.job import sample
from mbd_ros.features.simulation.particles import simulate
from mbd_ros.scene.describe.scene_summary import Lines
from mbd_ros.scene.particles import particle_scene
from mbd_ros.scene.variants import with_sections


class ParticleScene(particle_scene.ParticleScene):
    """A built scene of particles, with the jobs (simulate, sample, bracket) as methods."""

    simulate = simulate
    sample = sample
    bracket = bracket

    @classmethod
    def of(cls, scene: particle_scene.ParticleScene) -> "ParticleScene":
        """Return the same scene with the jobs as methods."""
        return cls(scene.origin, scene.parts, scene.entries)

    def with_(self, **sections: Any) -> "ParticleScene":
        """Return a copy of the scene with other sections.

        Args:
            **sections: New sections, written as for `scene_from`; None removes a section.

        Raises:
            SceneError: An entry is not accepted; the message names its key and accepted values.
        """
        return with_sections(self, **sections)

    def check(self) -> Lines:
        """Return the report of `mbd-ros check`.

        Raises:
            MbdError: The scene has no valid initial state.
        """
        from mbd_ros.scene.describe.particles import describe

        return Lines("\n".join(describe(self)))
