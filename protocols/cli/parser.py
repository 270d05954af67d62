"""The command `musebot`: parses a command line, runs its verb, returns the exit status."""

from __future__ import annotations

import argparse
import dataclasses
import os
import shutil
import sys
import types
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Union, get_args, get_origin, get_type_hints

from ... import __version__
from ..errors import InputError, nearest
from ..exit_status import exit_status
from ..terminal import safe_streams, say
from .options import usage_of
from .verbs import BENCHMARK, VERBS, verb_class

# Heavy imports (MuJoCo, torch) wait until a verb needs them: help appears at once, and MUJOCO_GL
# can still be chosen.

_UNCHECKED = ("doctor", "list")  # one checks the versions itself, the other simulates nothing
_HELP = ("-h", "--help")
_KINDS: Mapping[type, str] = {int: "a whole number", float: "a number"}
_NARROW, _WIDE = 60, 100  # columns of a help text


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command line (None: that of this process); prints the help if it has no words.

    Returns:
      The exit status, see `exit_status`.
    """
    safe_streams()
    words = [*(sys.argv[1:] if arguments is None else arguments)] or ["--help"]

    def run() -> None:
        if (command := _command(words)) is None:
            return
        # Before the first import of mujoco: films open EGL themselves.
        if words[0] != "explore":
            os.environ["MUJOCO_GL"] = "off"
        if words[0] not in _UNCHECKED:
            from ...models import check_versions

            check_versions()
        command()

    return exit_status(run)


def _command(words: list[str]) -> Callable[[], None] | None:
    """Returns the verb with its options set; None if help or the version was printed."""
    if words == ["--version"]:
        say(f"musebot {__version__}")
        return None
    prefix, verbs = "", VERBS
    if words[0] == "benchmark":
        prefix, verbs, words = "benchmark ", BENCHMARK, words[1:] or ["--help"]
    if words[0] in _HELP:
        say(overview(f"musebot {prefix}VERB", verbs), lines=True)
        return None
    verb = f"{prefix}{words[0]}"
    if verb not in verbs:
        raise InputError(f"there is no verb {verb!r}; {nearest(verb, verbs)}")
    return parsed(verb_class(verb), f"musebot {verb}", words[1:])


def overview(usage: str, verbs: Mapping[str, tuple[str, str, str]]) -> str:
    """Returns the help that lists verbs, each with a line about it."""
    about = {verb.split()[-1]: line for verb, (_, _, line) in verbs.items()}  # after `usage`
    width = max(map(len, about))
    lines = [f"usage: {usage} [OPTION ..]", ""]
    lines += ["Creative robots that learn during their lives, in MuJoCo.", ""]
    lines += [f"  {verb:{width}}  {line}" for verb, line in about.items()]
    lines += ["", f"`{usage} --help` explains a verb."]
    lines += ["`musebot --version` prints the version."]
    return "\n".join(lines)


def parsed(command: type, prog: str, words: Sequence[str]) -> Any:
    """Returns a command with the values that its words give; None if its help was printed.

    The command is a dataclass whose fields are made by `options.option` and `options.argument`.

    Raises:
      InputError: an argument is missing, unknown, or has a value that it cannot have.
    """
    parser = parser_of(command, prog)
    if any(word in _HELP for word in words):
        say(parser.format_help().rstrip(), lines=True)
        return None
    if "" in words:
        raise InputError("a word of the command is empty: is a variable of the shell unset?")
    values, left = parser.parse_known_args([*words])
    if left:
        if left[0].startswith("-"):
            known = [name for action in parser._actions for name in action.option_strings]
            meant = [action.dest for action in parser._actions if not action.option_strings]
            if left[0][2:] in meant:
                raise InputError(f"{left[0]} is no option: its value stands without {left[0]}")
            if (name := left[0].partition("=")[0]) == "--task" and "--life" in known:
                raise InputError("there is no option --task; did you mean --life?")
            raise InputError(f"there is no option {name}; {nearest(name, known)}")
        raise InputError(f"{left[0]!r} is one word too many")
    return command(**vars(values))


def parser_of(command: type, prog: str) -> argparse.ArgumentParser:
    """Returns the parser of a command's arguments."""
    parser = _Parser(
        prog=prog,
        usage=usage_of(prog, command),
        description=command.__doc__,
        allow_abbrev=False,
        add_help=False,
        argument_default=argparse.SUPPRESS,
        formatter_class=_Formatter,
    )
    hints = get_type_hints(command)
    groups: dict[str | None, Any] = {None: parser.add_argument_group()}  # positional, no title
    for field in dataclasses.fields(command):
        notes = field.metadata
        group = (notes["group"] or "options") if notes["option"] else None
        if group not in groups:
            groups[group] = parser.add_argument_group(group)
        _add(groups[group], field, hints[field.name])
    return parser


def _add(group: Any, field: dataclasses.Field[Any], hint: Any) -> None:
    notes = field.metadata
    name = f"--{field.name.replace('_', '-')}" if notes["option"] else notes["values"]
    kind, several = _kind(hint)
    settings: dict[str, Any] = {"help": notes["says"], "action": _Once}
    if kind is bool:
        group.add_argument(name, dest=field.name, nargs=0, **settings)
        return
    settings["metavar"] = notes["values"]
    settings["type"] = _reader(name, kind, notes["choices"])
    required = field.default is dataclasses.MISSING
    if several:
        settings["nargs"] = "+"
    elif not notes["option"] and not required:
        settings["nargs"] = "?"
    if notes["option"]:
        group.add_argument(name, dest=field.name, required=required, **settings)
    else:
        group.add_argument(field.name, **settings)


def _kind(hint: Any) -> tuple[type, bool]:
    """Returns the type of an option's values, and whether the option takes several."""
    if get_origin(hint) is tuple:
        return get_args(hint)[0], True
    if get_origin(hint) in (Union, types.UnionType):
        return next(one for one in get_args(hint) if one is not type(None)), False
    return hint, False


def _reader(name: str, kind: type, choices: Sequence[str]) -> Callable[[str], Any]:
    """Returns the function that reads a value of an option."""

    def read(word: str) -> Any:
        if choices and word not in choices:
            raise InputError(f"{name} must be one of {', '.join(choices)}, got {word!r:.60}")
        try:
            return kind(word)
        except ValueError as error:
            what = _KINDS[kind]
            raise InputError(f"{name} must be {what}, got {word!r:.60}") from error

    return read


class _Once(argparse.Action):
    """Stores the values of an option, and refuses the option a second time."""

    def __call__(
        self, parser: Any, namespace: Any, values: Any, option_string: str | None = None
    ) -> None:
        if str(values) == argparse.SUPPRESS:  # a positional argument that is not given
            return
        if hasattr(namespace, self.dest):
            raise InputError(
                f"{option_string} is given twice: give it once, followed by all its values"
            )
        if self.nargs == 0:
            values = True
        setattr(namespace, self.dest, tuple(values) if isinstance(values, list) else values)


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence."""

    def error(self, message: str) -> Any:
        message = message.removeprefix("argument ")
        raise InputError(message.replace("the following arguments are required: ", "missing: "))


class _Formatter(argparse.HelpFormatter):
    """Help of at least 60 and at most 100 columns, without blank lines."""

    def __init__(self, prog: str) -> None:
        columns = shutil.get_terminal_size().columns - 2
        super().__init__(prog, max_help_position=26, width=max(_NARROW, min(columns, _WIDE)))

    def format_help(self) -> str:
        return "".join(line for line in super().format_help().splitlines(True) if line.strip())

    def _format_args(self, action: argparse.Action, default_metavar: str) -> str:
        if action.nargs == argparse.ONE_OR_MORE:
            return f"{action.metavar} .."
        return super()._format_args(action, default_metavar)
