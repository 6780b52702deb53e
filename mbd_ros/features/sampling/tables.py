"""Tables of `mbd-ros sample`."""

from collections.abc import Mapping, Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.mean_force import Average, Histogram, MeanForce, Profile
from mbd_ros.files.table import Column, Table

AVERAGES = "averages"
HISTOGRAM = "histogram."  # before the name of a quantity
CHAINS = "chains"
PROFILE = "profile"
_AVERAGE = (  # columns of an average, and whether they have the unit of the quantity
    ("mean", True),
    ("standard_error", True),
    ("standard_deviation", True),
    ("autocorrelation_time", False),
    ("effective_samples", False),
    ("split_rhat", False),
)


def sample_table(values: Array, names: Sequence[str], units: Sequence[str]) -> Table:
    """All samples, chain by chain.

    Args:
        values: Shape (quantities, chains, samples).
    """
    _, chains, samples = values.shape
    columns = [
        Column("chain", np.repeat(np.arange(1, chains + 1), samples)),
        Column("sample", np.tile(np.arange(1, samples + 1), chains)),
    ]
    pairs = zip(names, units, values, strict=True)
    return Table([*columns, *(Column(n, v.ravel(), unit) for n, unit, v in pairs)])


def average_table(found: Mapping[str, Average], units: Sequence[str]) -> Table:
    """Averages in one row: `<quantity>.mean`, `.standard_error`, .."""
    columns = []
    for (name, one), unit in zip(found.items(), units, strict=True):
        for value, (word, has_unit) in zip(one, _AVERAGE, strict=True):
            columns.append(Column(f"{name}.{word}", np.array([value]), unit if has_unit else ""))
    return Table(columns)


def histogram_table(found: Histogram, unit: str) -> Table:
    """Shares of samples, a row a bin."""
    return Table(
        [
            Column("low", found.edges[:-1], unit),
            Column("high", found.edges[1:], unit),
            Column("share", found.shares),
            Column("standard_error", found.errors),
        ]
    )


def chain_table(accepted: Array) -> Table:
    """Chains, a row each."""
    return Table([Column("chain", np.arange(1, len(accepted) + 1)), Column("accepted", accepted)])


def profile_table(
    name: str, units: tuple[str, str], forces: Sequence[MeanForce], profile: Profile
) -> Table:
    """Mean force and free energy, a row a value of the coordinate.

    Args:
        name: Of the coordinate.
        units: Of the coordinate and of energies.
        forces: At its values.
        profile: Free energy there.
    """
    slope = f"{units[1]}/({units[0]})" if units[0] else units[1]

    def of(kind: str, field: str) -> Array:
        return np.array([getattr(getattr(one, kind), field) for one in forces])

    return Table(
        [
            Column(name, np.array([one.level for one in forces]), units[0]),
            Column("mean_force", of("force", "mean"), slope),
            Column("mean_force.standard_error", of("force", "error"), slope),
            Column("effective_samples", of("force", "effective")),
            Column("split_rhat", of("force", "rhat")),
            Column("multiplier", of("multiplier", "mean"), slope),
            Column("multiplier.standard_error", of("multiplier", "error"), slope),
            Column("free_energy", profile.energy, units[1]),
            Column("free_energy.standard_error", profile.errors, units[1]),
        ]
    )
