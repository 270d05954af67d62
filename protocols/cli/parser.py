"""The command `musebot`: from the words of a command line to a verb and its exit status."""

from __future__ import annotations

import dataclasses
import os
import re
import sys
from collections.abc import Iterator, Sequence
from typing import Any, Literal, get_args, get_origin, get_type_hints

import tyro

from ... import __version__
from ..compare import STUDIES
from ..errors import InputError, nearest
from ..exit_status import exit_status
from ..terminal import safe_streams, say
from .verbs import VERBS, study_command, verb_class

# Heavy imports (MuJoCo, torch) wait until a verb needs them: help appears at once, and MUJOCO_GL
# can still be chosen.

_DESCRIPTION = (
    "Creative robots that learn during their lives, in MuJoCo. `musebot VERB --help` explains a "
    "verb, `musebot --version` prints the version. Completion of words in bash: "
    'eval "$(musebot --tyro-print-completion bash)"; the same for zsh and tcsh.'
)
_UNCHECKED = ("doctor", "list")  # one checks the versions itself, the other simulates nothing
_CONFIG = (tyro.conf.FlagCreatePairsOff,)
_HELP = {"-h", "--help"}
_ONE_DASH = re.compile(r"-(?!(inf|infinity|nan)$)[a-z]", re.IGNORECASE)  # tyro takes no such word


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
    verb: Any = None
    stopped: Any = None

    def parse() -> None:
        nonlocal verb, stopped
        _check_given(words)
        try:
            verb = _parse(words)
        except SystemExit as stop:  # tyro has printed the help, or what is wrong
            stopped = stop.code

    status = exit_status(parse, check=False)  # a reader of help may close the pipe early
    if verb is None:
        return status or stopped or 0
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
        os.environ["MUJOCO_GL"] = "off"  # before the study's import of mujoco, as in `main`
        return parsed(study_command(study), f"musebot study {study}", words[2:])
    if name in VERBS:
        return parsed(verb_class(name), f"musebot {name}", words[1:])
    if name in STUDIES:
        raise InputError(f"{name} is a study: musebot study {name} OUT")
    if name not in _HELP and not name.startswith("--tyro-"):
        raise InputError(f"there is no verb {name!r}; {nearest(name, VERBS)}")
    return tyro.extras.subcommand_cli_from_dict(
        {name: verb_class(name) for name in VERBS},
        args=words,
        prog="musebot",
        description=_DESCRIPTION,
        config=_CONFIG,
    )


def parsed(command: type, prog: str, words: Sequence[str]) -> Any:
    """Returns a command with the values that its words give.

    Args:
      command: Dataclass of the command.
      prog: Name of the command.
      words: Options and other words; with --help among them, the help is printed instead.

    Raises:
      InputError: an argument is missing, unknown, or has a value that it cannot have.
      SystemExit: the help was printed, or other words cannot be parsed.
    """
    known = [*_arguments(command)]
    options = _before_dashes(words)
    if _HELP & {*options}:
        # tyro's usage leaves out given words, and in a long usage all options.
        required = [one.usage for one in known if one.required and not one.positional]
        prog, words = " ".join([prog, *required]), ["--help"]
    elif not any(word.startswith("--tyro-") for word in options):
        _check_words(known, words, prog)
    return tyro.cli(command, args=words, prog=prog, config=_CONFIG)


@dataclasses.dataclass(frozen=True)
class _Given:
    """An option of a command line.

    Attributes:
      name: Its name; tyro takes _ and - in it.
      values: Words that follow it.
      attached: Whether the first of them stands behind = in the same word.
    """

    name: str
    values: list[str]
    attached: bool


def _before_dashes(words: Sequence[str]) -> Sequence[str]:
    """Returns the words before `--`, after which no word is an option."""
    return words[: words.index("--")] if "--" in words else words


def _divided(words: Sequence[str]) -> tuple[list[str], list[_Given], list[str]]:
    """Returns the words before the first option, the options, and the words after `--`."""
    ahead = _before_dashes(words)
    first: list[str] = []
    given: list[_Given] = []
    for word in ahead:
        if word.startswith("--"):
            name, equals, value = word.partition("=")
            given.append(_Given(name.replace("_", "-"), [value] if equals else [], bool(equals)))
        else:
            (given[-1].values if given else first).append(word)
    return first, given, [*words[len(ahead) + 1 :]]


def _check_given(words: Sequence[str]) -> None:
    """Raises InputError for an empty word, and for an option that is given twice."""
    _, given, _ = _divided(words)
    if "" in words or any("" in one.values for one in given):
        raise InputError("a word of the command is empty: is a variable of the shell unset?")
    names = [one.name for one in given]
    for name in names:
        if names.count(name) > 1:  # tyro would use the last one only
            raise InputError(f"{name} is given twice: give it once, followed by all its values")


@dataclasses.dataclass(frozen=True)
class _Argument:
    """An option of a command, or a word without option, such as OUT.

    Attributes:
      name: Its name, with dashes if it is an option.
      hint: Its type.
      values: Its values as help shows them.
      required: Whether it must be given.
      positional: Whether it is a word without option.
    """

    name: str
    hint: Any
    values: str
    required: bool
    positional: bool

    @property
    def types(self) -> set[Any]:
        """Its type and the types within it."""
        return {self.hint, *get_args(self.hint)}

    @property
    def flag(self) -> bool:
        """Whether it takes no value."""
        return bool in self.types

    @property
    def several(self) -> bool:
        """Whether it takes all words that follow."""
        return get_origin(self.hint) is tuple

    @property
    def usage(self) -> str:
        """How it is given."""
        return self.name if self.positional else f"{self.name} {self.values}"

    def check(self, values: Sequence[str]) -> None:
        """Raises InputError for values that tyro would refuse, or take for others."""
        # tyro would take None for an option that is not given.
        if values[0] == "None" and type(None) in self.types:
            raise InputError(f"{self.name} must have a value, got None")
        for number, what in ((int, "a whole number"), (float, "a number")):
            if number in self.types:
                try:
                    number(values[0])
                except ValueError as error:
                    raise InputError(f"{self.name} must be {what}, got {values[0]!r}") from error
        choices = [
            name for one in self.types if get_origin(one) is Literal for name in get_args(one)
        ]
        for value in values if choices else ():
            if value not in choices:
                names = ", ".join(choices)
                raise InputError(f"{self.name} must be one of {names}, got {value!r}")


def _arguments(command: type) -> Iterator[_Argument]:
    """Yields the arguments of a command, those of its parts included."""
    hints = get_type_hints(command, include_extras=True)
    for field in dataclasses.fields(command):
        hint = hints[field.name]
        notes = getattr(hint, "__metadata__", ())
        kind = hint.__origin__ if notes else hint
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            yield from _arguments(kind)
            continue
        shown = (one.metavar for one in notes if getattr(one, "metavar", None))
        values, positional = next(shown, field.name.upper()), tyro.conf.Positional in notes
        yield _Argument(
            name=values if positional else f"--{field.name.replace('_', '-')}",
            hint=kind,
            values=values,
            required=field.default is field.default_factory is dataclasses.MISSING,
            positional=positional,
        )


def _check_words(known: Sequence[_Argument], words: Sequence[str], prog: str) -> None:
    """Raises InputError, one sentence, for what tyro would refuse with a panel."""
    options = {one.name: one for one in known if not one.positional}
    places = [one for one in known if one.positional]
    alone, given, last = _divided(words)
    for word in _before_dashes(words):
        if _ONE_DASH.match(word):
            near = nearest(word, options)
            if not near.startswith("did you mean"):
                near = "a value that begins with a dash stands behind =, as in --output=-f.mp4"
            raise InputError(f"there is no option {word}; {near}")
    for one in given:
        if one.name not in options:
            raise InputError(f"there is no option {one.name}; {nearest(one.name, options)}")
        option, values = options[one.name], one.values
        if option.flag and one.attached:
            raise InputError(f"{one.name} takes no value, got {values[0]!r}")
        most = 0 if option.flag else 1
        if option.several:
            # tyro leaves the last words of the last option for the places that are still open.
            open_ = [place for place in places[len(alone) :] if place.required]
            spare = len(open_) if one is given[-1] and "--" not in words else 0
            if 0 < len(values) <= spare:
                raise InputError(f"{one.name} needs a value, or {open_[-1].name} is missing")
            most = len(values) - spare
        if not option.flag and not values:  # tyro accepts none where several are allowed
            raise InputError(f"{one.name} needs a value")
        if most:
            option.check(values[:most])
        alone += values[most:]
    alone += last
    for place, word in zip(places, alone, strict=False):
        place.check([word])
    if len(alone) > len(places):
        raise InputError(f"{alone[len(places)]!r} is one word too many")
    missing = [place for place in places[len(alone) :] if place.required]
    names = {one.name for one in given}
    missing += [one for one in options.values() if one.required and one.name not in names]
    if missing:
        needs = " ".join([prog, *(one.usage for one in known if one.required)])
        greedy = [one for one in given[:-1] if len(one.values) > 1 and options[one.name].several]
        if greedy and missing[0].positional:
            needs += f" (all words after {greedy[0].name} are its values)"
        raise InputError(f"{missing[0].name} is missing: {needs}")
