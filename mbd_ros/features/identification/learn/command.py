"""Words of `mbd-ros learn`."""

import argparse
from collections.abc import Collection

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `learn` understands."""
    add_scene(parser)
    parser.add_argument(
        "motion", type=path_word, nargs="*", help="tables or bags with positions and efforts"
    )
    parser.add_argument(
        "-o", "--out", type=path_word, required=True, help="folder for the model (required)"
    )
    parser.add_argument(
        "--variant",
        choices=("free", "structured", "informed"),
        default="free",
        help="a network without structure; friction and a Lagrangian; or without structure, and "
        "drawn to the equations of motion where nothing was measured (default: %(default)s)",
    )
    parser.add_argument(
        "--physics",
        choices=("identified", "given"),
        default="identified",
        help="what the network stands on: the scene identified from the same samples first, or "
        "as given (default: %(default)s)",
    )
    parser.add_argument(
        "--freeze",
        nargs="+",
        default=["physics"],
        metavar="WHAT",
        help="physics, or all-but adapters: what does not change while a model of --start is "
        "adapted (default: physics)",
    )
    parser.add_argument("--start", type=path_word, help="folder of the model that is adapted")
    parser.add_argument(
        "--compare", action="store_true", help="compare five ways from more and more seconds"
    )
    _add_numbers(parser)


def _add_numbers(parser: argparse.ArgumentParser) -> None:
    """How recordings are looked at, and numbers of the optimisation."""
    parser.add_argument(
        "--wrenches",
        type=path_word,
        nargs="+",
        default=(),
        help="tables of the loads in the scene, one a motion; a bag carries its own",
    )
    parser.add_argument(
        "--topic", default="/joint_states", help="JointState topic of bags (default: %(default)s)"
    )
    parser.add_argument(
        "--derivatives",
        choices=("given", "zero-phase"),
        help="where velocities and accelerations come from (default: given where a motion has "
        "accelerations, else zero-phase)",
    )
    parser.add_argument(
        "--band", type=float, help="end of the band in Hz (default: from the motion)"
    )
    parser.add_argument(
        "--learned",
        type=float,
        default=0.6,
        help="share of the time of each recording that is learned from (default: %(default)s)",
    )
    parser.add_argument(
        "--members", type=int, default=5, help="networks of the ensemble (default: %(default)s)"
    )
    parser.add_argument("--steps", type=int, help="of the optimisation (default: by variant)")
    parser.add_argument(
        "--rate", type=float, default=0.01, help="first learning rate (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="of the random numbers (default: %(default)s)"
    )
    parser.add_argument(
        "--seeds", type=int, default=3, help="how many with --compare (default: %(default)s)"
    )


def _frozen(words: list[str], accepted: Collection[str]) -> tuple[str, list[str]]:
    """What --freeze says, and motions that stand behind it."""
    for count in (1, 2):
        if " ".join(words[:count]) in accepted:
            return " ".join(words[:count]), words[count:]
    return " ".join(words), []


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say; the exit code."""
    from mbd_ros.features.identification.learn.comparison import compare_to
    from mbd_ros.features.identification.learn.job import learn_to
    from mbd_ros.features.identification.learn.task import FREEZE, Task
    from mbd_ros.scene.reader import load_scene

    names = ("wrenches", "topic", "derivatives", "band", "learned", "variant", "physics")
    names += ("members", "steps", "seed", "rate")
    options = {name: getattr(arguments, name) for name in names}
    freeze, after = _frozen(arguments.freeze, FREEZE)
    motions = [*arguments.motion, *map(path_word, after)]
    task = Task(motions, freeze=freeze, **options)
    scene = load_scene(arguments.scene)
    if arguments.compare:
        compare_to(scene, task, arguments.out, arguments.seeds, say)
    else:
        learn_to(scene, task, arguments.out, arguments.start, say)
    return OK
