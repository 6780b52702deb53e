"""Words for quantities: `distance a b`, `cosine a b c`, a joint."""

from mbd_ros.errors import SceneError
from mbd_ros.features.sampling import observables
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.sampled_scene import SampledScene
from mbd_ros.scene.schema.nearest import nearest

_POINTS = {"distance": 2, "cosine": 3, "angle": 3, "dihedral": 4, "quadratic": 1}
_FORMS = (
    "distance A B, cosine A B C, angle A B C, dihedral A B C D, quadratic A wx wy wz, "
    "A.x of particles"
)
DRIVEN = ("distance", "cosine", "angle", "quadratic")  # forces are averaged along these


def quantity(text: str, scene: SampledScene, where: str, name: str = "") -> Observable:
    """The quantity of some words.

    Args:
        text: The words.
        scene: What is sampled.
        where: File and key, for the messages.
        name: As columns have it; by default that of the words.

    Raises:
        SceneError: Names what is wrong and what is accepted.
    """
    words = text.split()
    if len(words) == 1:
        return _coordinate(words[0], scene, where, name)
    kind, rest = words[0] if words else "", words[1:]
    if not scene.points or kind not in _POINTS:
        accepted = _FORMS if scene.points else ", ".join(scene.space.names)
        raise SceneError(f"{where}: '{text}' is no quantity, accepted: {accepted}")
    count = _POINTS[kind]
    numbers = rest[count:]
    if len(rest) < count or len(numbers) != (3 if kind == "quadratic" else 0):
        raise SceneError(f"{where}: '{text}', accepted: {_FORMS}")
    points = [_point(word, scene, where) for word in rest[:count]]
    if len(set(points)) < count:
        raise SceneError(f"{where}: '{text}' names a particle twice")
    label, unit = name or "_".join([kind, *rest[:count]]), scene.length
    if kind == "distance":
        return observables.distance(label, unit, *points)
    if kind == "cosine":
        return observables.cosine(label, *points)
    if kind == "angle":
        return observables.angle(label, *points)
    if kind == "dihedral":
        return observables.dihedral(label, points)
    weights = [_number(word, text, where) for word in numbers]
    return observables.quadratic(label, f"{unit}^2", points[0], weights)


def _coordinate(word: str, scene: SampledScene, where: str, name: str) -> Observable:
    names = list(scene.space.names)
    if word not in names:
        close = ", ".join(nearest(word, names) or names[:6])
        raise SceneError(f"{where}: '{word}' is no quantity, the nearest: {close}")
    if scene.points:
        return observables.coordinate(name or word, scene.length, names.index(word))
    return scene.defaults[names.index(word)]._replace(name=name or f"{word}.position")


def _point(word: str, scene: SampledScene, where: str) -> int:
    if word not in scene.points:
        close = ", ".join(nearest(word, list(scene.points)) or scene.points[:6])
        raise SceneError(f"{where}: there is no particle '{word}', the nearest: {close}")
    return list(scene.points).index(word)


def _number(word: str, text: str, where: str) -> float:
    try:
        found = float(word)
    except ValueError:
        found = float("nan")
    if not abs(found) < 1.0e30:
        raise SceneError(f"{where}: '{text}': '{word}' is no number")
    return found
