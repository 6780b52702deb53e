"""Drake on contact problems."""

import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from pydrake.geometry import (
    AddContactMaterial,
    Box,
    CollisionFilterDeclaration,
    GeometrySet,
    HalfSpace,
    ProximityProperties,
    SceneGraph,
    Sphere,
)
from pydrake.math import RigidTransform
from pydrake.multibody.plant import (
    AddMultibodyPlantSceneGraph,
    CoulombFriction,
    DiscreteContactApproximation,
    MultibodyPlant,
)
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder

from mbd_ros.applications.report.contact.problems import (
    GROUND,
    Problem,
    Solid,
    Trace,
    damping_ratio,
)
from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.core.state import Array
from mbd_ros.errors import DivergedError

SETUP = (
    "Drake: discrete plant, SAP and TAMSI with point contact; boxes stand on four spheres of 1 cm,"
    " since a box on a plane has one contact point there; stiffness of 1e5 to 1e11 N/m per kg "
    "above the contact, 1e3 to 1e5 where it bounces; SAP with a relaxation time of a step, or that"
    " of the restitution less what a step damps, and without its bound of near rigidity; TAMSI "
    "with stiction tolerances of 1e-4 and 1e-8 m/s; the dissipation of TAMSI depends on the speed,"
    " so that it has no constant restitution."
)
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4)  # s
_RATES = (1e5, 1e8, 1e11)  # N/m per kg
_SOFT = (1e3, 1e4, 1e5)  # the same where a contact bounces
_STICTIONS = (1e-4, 1e-8)  # m/s
_DISSIPATION = 10.0  # s/m, of TAMSI without restitution
_FOOT = 0.01  # m


class Settings(NamedTuple):
    """One way to run Drake.

    Attributes:
        is_convex: SAP, otherwise TAMSI.
        dt: Step [s].
        rate: Stiffness over the mass above a contact [1/s^2].
        stiction: Speed at which TAMSI lets contacts creep [m/s].
    """

    is_convex: bool
    dt: float
    rate: float
    stiction: float = 1e-4


class DrakeContacts:
    """One approximation, step and stiffness.

    Args:
        settings: How it is run.
    """

    package = "Drake"

    def __init__(self, problem: Problem, settings: Settings) -> None:
        self._problem, self._settings = problem, settings
        builder = DiagramBuilder()
        self._plant, scene_graph = AddMultibodyPlantSceneGraph(builder, settings.dt)
        _fill(self._plant, scene_graph, problem, settings)
        self._diagram = builder.Build()
        name = "SAP" if settings.is_convex else f"TAMSI, stiction {settings.stiction:.0e} m/s"
        self.setup = f"{name}, {settings.rate:.0e} N/m/kg"
        self.record: Record = {"dt": settings.dt}

    def run(self, times: Sequence[float]) -> tuple[Trace, float]:
        """States at the samples, and CPU time [s].

        Raises:
            DivergedError: Drake gives up.
        """
        simulator, plant = Simulator(self._diagram), self._plant
        root = simulator.get_mutable_context()
        context = plant.GetMyMutableContextFromRoot(root)
        v = [(*solid.spin, *solid.v) for solid in self._problem.solids]
        plant.SetVelocities(context, np.concatenate(v))
        states, used = [], 0.0
        try:
            simulator.Initialize()
            for t in times:
                used += cpu_time(lambda end=t: simulator.AdvanceTo(end))
                q = plant.GetPositions(context).reshape(-1, 7)
                v = plant.GetVelocities(context).reshape(-1, 6)
                states.append((q[:, 4:], v[:, 3:], v[:, :3]))
        except RuntimeError as error:
            raise DivergedError(f"Drake: {error}"[:160]) from error
        forces = _forces(self._problem, plant, context)
        return Trace(*(np.array(part) for part in zip(*states, strict=True)), forces), used


def runs(problem: Problem, quick: bool) -> Iterator[DrakeContacts]:
    """The sweep over approximations, steps and stiffnesses."""
    for dt in _STEPS[2:4] if quick else _STEPS:
        rates = _SOFT if problem.restitution else _RATES
        for rate in rates[1:2] if quick else rates:
            yield DrakeContacts(problem, Settings(True, dt, rate))
            if not problem.restitution:
                for stiction in _STICTIONS[:1] if quick or not problem.mu else _STICTIONS:
                    yield DrakeContacts(problem, Settings(False, dt, rate, stiction))


def _fill(
    plant: MultibodyPlant, scene_graph: SceneGraph, problem: Problem, settings: Settings
) -> None:
    approximation = DiscreteContactApproximation
    plant.set_discrete_contact_approximation(
        approximation.kSap if settings.is_convex else approximation.kTamsi
    )
    if settings.is_convex:
        plant.set_sap_near_rigid_threshold(0.0)
    else:
        plant.set_stiction_tolerance(settings.stiction)
    plant.mutable_gravity_field().set_gravity_vector(np.array(problem.gravity))
    loads = np.cumsum([solid.mass for solid in problem.solids][::-1])[::-1]
    material = _material(problem, settings, float(loads[0]))
    world = plant.world_body()
    ground = plant.RegisterCollisionGeometry(
        world, RigidTransform(), HalfSpace(), GROUND, material
    )
    tops, feet = [ground], []
    for solid, load in zip(problem.solids, loads, strict=True):
        material = _material(problem, settings, float(load))
        mine = _add(plant, solid, material, has_top=len(problem.solids) > 1)
        tops, feet = [*tops, *mine[0]], [*feet, *mine[1]]
    filters = scene_graph.collision_filter_manager()
    for group in (tops, feet):
        filters.Apply(CollisionFilterDeclaration().ExcludeWithin(GeometrySet(group)))
    plant.Finalize()
    for solid in problem.solids:
        body = plant.GetBodyByName(solid.name)
        plant.SetDefaultFloatingBaseBodyPose(body, RigidTransform(np.array(solid.at)))


def _add(
    plant: MultibodyPlant, solid: Solid, material: ProximityProperties, *, has_top: bool
) -> tuple[list[Any], list[Any]]:
    """A solid; what others stand on, and what it stands on."""
    unit = UnitInertia(*(solid.moments / solid.mass))
    centre = np.array(solid.centre)
    about_middle = unit.ShiftFromCenterOfMass(-centre)
    body = plant.AddRigidBody(solid.name, SpatialInertia(solid.mass, centre, about_middle))

    def shape(kind: Any, place: Array, name: str) -> Any:
        at = RigidTransform(place)
        return plant.RegisterCollisionGeometry(body, at, kind, f"{solid.name}_{name}", material)

    if solid.shape == "sphere":
        return [], [shape(Sphere(solid.size[0]), np.zeros(3), "ball")]
    inside = np.array([_FOOT, _FOOT, 0.0] if solid.shape == "box" else np.zeros(3))
    places = solid.feet - np.sign(solid.feet) * inside + (0.0, 0.0, _FOOT)
    feet = [shape(Sphere(_FOOT), place, f"foot{i}") for i, place in enumerate(places)]
    return [shape(Box(*solid.size), np.zeros(3), "top")] if has_top else [], feet


def _material(problem: Problem, settings: Settings, load: float) -> ProximityProperties:
    """Half of the compliance of a contact, which is that of two."""
    stiffness, relaxation = settings.rate * load, settings.dt
    if problem.restitution:  # the step itself damps by half its angle
        omega = math.sqrt(settings.rate)
        ratio = damping_ratio(problem.restitution) - 0.5 * omega * settings.dt
        relaxation = max(0.0, 2.0 * ratio / omega)
    properties, friction = ProximityProperties(), CoulombFriction(problem.mu, problem.mu)
    AddContactMaterial(_DISSIPATION, 2.0 * stiffness, friction, properties)
    properties.AddProperty("material", "relaxation_time", 0.5 * relaxation)
    return properties


def _forces(problem: Problem, plant: MultibodyPlant, context: Any) -> Array:
    """Normal forces at the end [N], as `Trace` orders them."""
    results = plant.get_contact_results_output_port().Eval(context)
    is_split = problem.solids[0].shape == "feet"
    forces = np.zeros(4 if is_split else len(problem.pairs))
    for i in range(results.num_point_pair_contacts()):
        contact = results.point_pair_contact_info(i)
        bodies = (int(contact.bodyA_index()), int(contact.bodyB_index()))
        solid = max(bodies) - 1
        force = contact.contact_force().dot(contact.point_pair().nhat_BA_W)
        if is_split:
            feet = problem.solids[0].feet[:, :2]
            solid = int(np.argmin(np.linalg.norm(feet - contact.contact_point()[:2], axis=1)))
        forces[solid] += abs(force)
    return forces
