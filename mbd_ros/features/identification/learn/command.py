"""Command line of `mbd-ros learn`."""

import argparse
from collections.abc import Collection

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `learn` to a parser."""
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
        help="free: a network without structure; structured: friction and a Lagrangian; informed: "
        "free, and follows the equations of motion off the data (default: %(default)s)",
    )
    parser.add_argument(
        "--physics",
        choices=("identified", "given"),
        default="identified",
        help="scene that the network corrects: first identified from the same samples, or "
        "as given (default: %(default)s)",
    )
    parser.add_argument(
        "--freeze",
        nargs="+",
        default=["physics"],
        metavar="WHAT",
        help="what does not change while the model of --start is adapted: physics, or all-but "
        "adapters (default: physics)",
    )
    parser.add_argument("--start", type=path_word, help="folder of a model to adapt")
    parser.add_argument(
        "--compare", action="store_true", help="compare five methods over growing training times"
    )
    _add_numbers(parser)


def _add_numbers(parser: argparse.ArgumentParser) -> None:
    """Add options about the processing of recordings and about the optimization."""
    parser.add_argument(
        "--wrenches",
        type=path_word,
        nargs="+",
        default=(),
        help="tables of the external loads, one per motion; a bag contains its own",
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
        help="share of the time of each recording that is for training (default: %(default)s)",
    )
    parser.add_argument(
        "--members", type=int, default=5, help="networks of the ensemble (default: %(default)s)"
    )
    parser.add_argument("--steps", type=int, help="optimization steps (default: by variant)")
    parser.add_argument(
        "--rate", type=float, default=0.01, help="first learning rate (default: %(default)s)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the random numbers (default: %(default)s)"
    )
    parser.add_argument(
        "--seeds", type=int, default=3, help="seeds with --compare (default: %(default)s)"
    )


def _split_freeze(arguments: list[str], accepted: Collection[str]) -> tuple[str, list[str]]:
    """Return the value of --freeze, and the motions that follow it on the command line."""
    for count in (1, 2):
        if " ".join(arguments[:count]) in accepted:
            return " ".join(arguments[:count]), arguments[count:]
    return " ".join(arguments), []


def run(arguments: argparse.Namespace) -> int:
    """Run the command, and return its exit code."""
    from mbd_ros.features.identification.learn.comparison import compare_to
    from mbd_ros.features.identification.learn.job import learn_to
    from mbd_ros.features.identification.learn.task import FREEZE, Task
    from mbd_ros.scene.reader import load_scene

    names = ("wrenches", "topic", "derivatives", "band", "learned", "variant", "physics")
    names += ("members", "steps", "seed", "rate")
    options = {name: getattr(arguments, name) for name in names}
    freeze, after = _split_freeze(arguments.freeze, FREEZE)
    motions = [*arguments.motion, *map(path_word, after)]
    task = Task(motions, freeze=freeze, **options)
    scene = load_scene(arguments.scene)
    if arguments.compare:
        compare_to(scene, task, arguments.out, arguments.seeds, say)
    else:
        learn_to(scene, task, arguments.out, arguments.start, say)
    return OK
