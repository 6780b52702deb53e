"""Options of commands: one home for a key, its default and its description."""

import argparse
import ast

import pytest
from places import ROOT

from mbd_ros.features.muscles.static_optimization import EXPONENTS
from mbd_ros.features.sampling.chains import _STEPS_OF_JOINTS, _STEPS_OF_POINTS
from mbd_ros.jobs.options import add_option, add_options, given_options, parameters_of
from mbd_ros.jobs.table import COMMANDS
from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.motion.derivatives import GAIT
from mbd_ros.scene.schema.locate import path_word

DERIVATIVES = "mbd_ros.motion.derivatives:Derivatives"
MUSCLES = "mbd_ros.features.muscles.task:task_of_keys"
SAMPLE = "mbd_ros.features.sampling.task:SampleTask"


def parser_of(job, *names, **changes):
    parser = argparse.ArgumentParser()
    for name in names:
        add_option(parser, job, name, **changes)
    return parser


def test_a_signature_gives_kind_choices_default_and_text():
    source = parameters_of(DERIVATIVES)["source"]
    assert source.choices == ("given", "causal", "zero-phase", "opensim")
    assert source.default == "given" and "zero-phase: a low-pass filter" in source.text
    muscles = parameters_of(MUSCLES)
    assert muscles["reactions"].choices == ("child", "parent", "ground")  # an imported Literal
    assert (muscles["emg_weight"].kind, muscles["emg_weight"].default) == (float, 10.0)
    assert muscles["links"].is_list and muscles["passive"].kind is bool
    assert parameters_of("mbd_ros.motion.samples:Task")["wrenches"].kind is path_word


def test_options_have_the_spelling_kind_and_default_of_the_signature():
    parser = parser_of(MUSCLES, "emg_weight", "passive", "objective")
    assert vars(parser.parse_args([])) == {
        "emg_weight": 10.0,
        "passive": False,
        "objective": "activation",
    }
    given = parser.parse_args(["--emg-weight", "3", "--passive", "--objective", "stress"])
    assert (given.emg_weight, given.passive, given.objective) == (3.0, True, "stress")
    assert "activations (default: 10.0)." in " ".join(parser.format_help().split())


def test_an_option_that_a_task_file_may_say_is_none_and_its_help_has_the_default():
    parser = parser_of(MUSCLES, "emg_weight", "interval", only_given=True)
    assert given_options(parser.parse_args([]), "emg_weight", "interval") == {}
    assert given_options(parser.parse_args(["--interval", "1"]), "interval") == {"interval": 1.0}
    assert "mesh of --dynamics [s] (default: 0.02)." in " ".join(parser.format_help().split())


def test_a_list_takes_several_values():
    parser = argparse.ArgumentParser()
    add_options(parser, SAMPLE, "at", "seed")
    assert parser.parse_args(["--at", "1", "2.5", "--seed", "7"]).at == [1.0, 2.5]


def test_defaults_in_descriptions_are_those_of_the_code():
    cutoff = parameters_of(DERIVATIVES)["cutoff"].text
    assert f"{Tuning().cutoff:g} Hz for causal" in cutoff and f"{GAIT:g} Hz for opensim" in cutoff
    steps = parameters_of(SAMPLE)["steps"].text
    assert f"{_STEPS_OF_POINTS} for particles and {_STEPS_OF_JOINTS} for mechanisms" in steps
    exponent = parameters_of(MUSCLES)["exponent"].text
    assert f"{EXPONENTS['activation']:g} for activation and volume" in exponent
    assert f"{EXPONENTS['stress']:g} for stress and {EXPONENTS['metabolic']:g} for" in exponent
    assert EXPONENTS["volume"] == EXPONENTS["activation"]


def repeated(source):
    """Lines of a command that state a default, or the choices of a key, on their own."""
    for node in ast.walk(ast.parse(source)):
        if not (isinstance(node, ast.Call) and getattr(node.func, "attr", "") == "add_argument"):
            continue
        for keyword in node.keywords:
            value, text = literal(keyword.value), ast.unparse(keyword.value)
            is_default = keyword.arg == "default" and value not in (None, (), [])
            is_text = keyword.arg == "help" and "default: " in text and "%(default)s" not in text
            is_choice = keyword.arg == "choices" and value is not None
            if is_default or is_text or is_choice:
                yield f"line {node.lineno}: {keyword.arg}={text}"


def literal(expression):
    """The value of a literal; None for a name or a call."""
    try:
        return ast.literal_eval(expression)
    except ValueError:
        return None


MODULES = sorted({c.module for c in COMMANDS.values() if ".features." in c.module})


@pytest.mark.parametrize("module", [*MODULES, "mbd_ros.motion.options"])
def test_no_command_repeats_a_default_or_a_choice(module):
    path = ROOT / f"{module.replace('.', '/')}.py"
    assert list(repeated(path.read_text(encoding="utf-8"))) == []


@pytest.mark.parametrize(
    "words",
    [
        "'--tube', type=int, default=48",
        "'--inputs', choices=('efforts', 'none')",
        "'--dt', type=float, help='step (default: of the scene)'",
    ],
)
def test_a_repeated_default_or_choice_is_seen(words):
    assert len(list(repeated(f"parser.add_argument({words})"))) == 1
