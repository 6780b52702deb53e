"""What a simulation did, in lines for people."""

from collections.abc import Iterator

import numpy as np

from mbd_ros.core.dynamics.phase_queries import phase_names
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.integration.blocks import BlockStepper
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.thresholds import TOGGLE
from mbd_ros.files.table import Table
from mbd_ros.files.times import TIME
from mbd_ros.motion.state_table import BALANCE

_HANDED_OVER = "compiled ones do not take rows near dependence, nor states that are not finite"


def summary(simulation: Simulation, table: Table, wall: float, evaluations: int) -> Iterator[str]:
    """Lines on the steps that were taken, their cost, and what they kept.

    Args:
        simulation: After its run.
        table: The samples.
        wall: Time that the run took [s].
        evaluations: How often accelerations were computed.
    """
    duration = table[TIME][-1] - table[TIME][0]
    energy, position, velocity = (table[name] for name in BALANCE)
    change = float(np.abs(energy - energy[0]).max())
    per_step = evaluations / max(simulation.steps, 1)
    method = simulation.integrator.title
    yield (
        f"{method}, tier {tier_of(simulation.system)}: {simulation.steps} steps, {evaluations} "
        f"evaluations ({per_step:.2f} a step)"
    )
    if isinstance(simulation.stepper, BlockStepper) and simulation.stepper.handed_over:
        yield f"{simulation.stepper.handed_over} of the steps were plain: {_HANDED_OVER}"
    yield f"{wall:.3f} s for {duration:g} s, real-time factor {duration / max(wall, 1e-9):.1f}"
    yield f"energy {energy[0]:.6g} J, largest change {change:.3g} J"
    yield f"largest violation: position {position.max():.2g}, velocity {velocity.max():.2g}"
    if phases := phase_names(simulation.system):
        ends = [event.before.mode[0] for event in simulation.events if event.ends_phase]
        counts = (f"{name} {ends.count(i)} times" for i, name in enumerate(phases))
        yield f"phases ended: {', '.join(counts)}"
    condition, t = simulation.worst
    if 1.0 < condition < np.inf:
        doubt = "; near a toggle, multipliers there are unreliable" if condition > TOGGLE else ""
        yield f"condition number of the rows up to {condition:.2g}, at t = {t:g} s{doubt}"
    if simulation.system.bounded is not None:
        s = simulation.system.bounded.qp.statistics
        yield f"QP: {s.solves} solves, {s.cold} cold, {s.damped} damped, {s.failed} failed"
