"""The command `musebot`: from the words of a command line to a verb and its exit status."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Any

import tyro

from .. import __version__
from .commands import VERBS, study_command, verb_class
from .errors import InputError, nearest
from .exit_status import complain, exit_status
from .studies import STUDIES
from .terminal import safe_streams, say

# Heavy imports (MuJoCo, torch) wait until a verb needs them: help appears at once, and MUJOCO_GL
# can still be chosen.

_DESCRIPTION = (
    "Creative robots that learn during their lives, in MuJoCo. `musebot VERB --help` explains a "
    "verb, `musebot --version` prints the version. Completion of words in bash: "
    'eval "$(musebot --tyro-print-completion bash)"; the same for zsh and tcsh.'
)
_UNCHECKED = ("doctor", "list")  # one checks the versions itself, the other simulates nothing
_CONFIG = (tyro.conf.FlagCreatePairsOff,)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; without words, it prints the help.

    Args:
      arguments: Words of the command line; None for those of this process.

    Returns:
      The exit status: 0, 1 for a failure, 2 for bad input, 130 for Ctrl-C, 141 for a closed pipe.
    """
    safe_streams()
    words = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]
    if words == ["--version"]:
        return exit_status(lambda: say(f"musebot {__version__}"), check=False)
    options = [word.partition("=")[0] for word in words if word.startswith("--")]
    given = [name.replace("_", "-") for name in options]  # tyro takes both
    for name in given:
        if given.count(name) > 1:  # tyro would use the last one only
            return complain(f"{name} is given twice: give it once, followed by all its values", 2)
    verb: Any = None

    def parse() -> None:
        nonlocal verb
        verb = _parse(words)

    if status := exit_status(parse, check=False):  # a reader of help may close the pipe early
        return status
    # Before the first import of mujoco: a film opens EGL itself, the other verbs draw nothing.
    if words[0] != "explore":
        os.environ["MUJOCO_GL"] = "off"
    return exit_status(verb, check=words[0] not in _UNCHECKED and words != ["study"])


def _parse(words: list[str]) -> Any:
    name = words[0]
    if name == "study" and len(words) > 1 and not words[1].startswith("-"):
        study = words[1]
        if study not in STUDIES:
            raise InputError(f"there is no study {study!r}; {nearest(study, STUDIES)}")
        os.environ.setdefault("MUJOCO_GL", "off")
        command, prog = study_command(study), f"musebot study {study}"
        return tyro.cli(command, args=words[2:], prog=prog, config=_CONFIG)
    if name in VERBS:
        prog = f"musebot {name}"
        return tyro.cli(verb_class(name), args=words[1:], prog=prog, config=_CONFIG)
    if not name.startswith("-"):
        if name in STUDIES:
            raise InputError(f"{name} is a study: musebot study {name} OUT")
        raise InputError(f"there is no verb {name!r}; {nearest(name, VERBS)}")
    return tyro.extras.subcommand_cli_from_dict(
        {name: verb_class(name) for name in VERBS},
        args=words,
        prog="musebot",
        description=_DESCRIPTION,
        config=_CONFIG,
    )
