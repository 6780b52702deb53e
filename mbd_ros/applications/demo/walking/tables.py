"""Tables of the swing."""

import numpy as np

from mbd_ros.applications.demo.summary import Table, check_table
from mbd_ros.applications.demo.walking.numbers import END, WalkingNumbers, columns, rms
from mbd_ros.applications.demo.walking.task import JOINTS
from mbd_ros.files.table import MAIN


def tables(numbers: WalkingNumbers) -> list[Table]:
    """The whole summary."""
    found = [_joints(numbers), _knee(numbers), _muscles(numbers), _residuals(numbers)]
    return [*found, check_table(numbers.checks())]


def _joints(numbers: WalkingNumbers) -> Table:
    angle = 1e3 * rms(numbers.inner(numbers.angle_errors))
    moment, span = rms(numbers.inner(numbers.moment_errors)), numbers.moment_ranges
    rows = [
        (joint, f"{a:.2f}", f"{r:.3g}", f"{m:.3g} ({100 * m / r:.1f} %)")
        for joint, a, r, m in zip(JOINTS, angle, span, moment, strict=True)
    ]
    heads = ("joint", "angle, error [mrad]", "range of the moment [N·m]", "its error [N·m]")
    return Table(f"Joints: RMS errors, {END:g} s at both ends left out", heads, rows)


def _knee(numbers: WalkingNumbers) -> Table:
    peak = np.linalg.norm(numbers.load, axis=1).max() / numbers.weight
    rows = [("simulated", f"{peak:.2f}", "-", "-")]
    for text, result in (("from markers", numbers.forces), ("of the true motion", numbers.shared)):
        largest = np.linalg.norm(numbers.load_of(result), axis=1).max() / numbers.weight
        error = numbers.inner(numbers.load_errors(result))
        rows.append((text, f"{largest:.2f}", f"{rms(error):.3f}", f"{error.max():.3f}"))
    heads = ("", "peak", "error, RMS", "error, largest")
    return Table(f"Load of the knee in body weights of {numbers.weight:.0f} N", heads, rows)


def _muscles(numbers: WalkingNumbers) -> Table:
    swing, found, names = numbers.swing[MAIN], numbers.forces, numbers.muscles
    tension = columns(numbers.swing, names, "tension")
    error = rms(numbers.inner(columns(found, names, "force") - tension))
    rows = [
        (
            name,
            f"{swing[f'{name}.activation'].max():.3f}",
            f"{found[MAIN][f'{name}.activation'].max():.3f}",
            f"{tension[:, i].max():.0f}",
            f"{found[MAIN][f'{name}.force'].max():.0f}",
            f"{error[i]:.0f}",
        )
        for i, name in enumerate(names)
    ]
    heads = ("muscle", "activation", "found", "force [N]", "found", "error, RMS")
    return Table("Muscles: largest activations and forces, simulated and found", heads, rows)


def _residuals(numbers: WalkingNumbers) -> Table:
    seen, shares = numbers.motion["residuals"], numbers.forces[MAIN]
    rows = [
        ("markers, RMS", f"{1e3 * rms(seen['rms']):.3f} mm"),
        ("markers, largest", f"{1e3 * seen['max'].max():.2f} mm"),
        ("reserves, largest", f"{1e3 * np.abs(numbers.reserves).max():.3g} mN·m"),
        ("conditions of the optimum, largest", f"{shares['muscles.residual'].max():.2g}"),
    ]
    return Table("Residuals", ("", "value"), rows)
