"""
The parser of a command: how its arguments are declared, and its --help.

argparse parses; the help is written here, the same in all versions of Python. It leaves out options
that few people need, and --help-all shows them, too.
"""

from __future__ import annotations

import argparse
import os
import re
from functools import partial, wraps

from .foreign import place
from .output import PROGRAM, complain

TYPE_CHECKING = False  # see commands
if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
    from typing import Any, NoReturn

POSITIONAL, OPTIONS = "positional arguments", "options"
"""The titles of the arguments that are in no group."""

HELP_COLUMN = 24
"""The column of --help at which the texts begin at the latest."""


class Group:
    """Arguments under one title of --help; `container` is that of argparse, to which they go."""

    def __init__(self, parser: Parser, title: str, container: Any) -> None:
        self.parser: Parser = parser
        self.title: str = title
        self.container: Any = container

    def exclusive(self) -> Group:
        """Return a group, under the same title, of arguments that exclude each other."""
        return Group(self.parser, self.title, self.container.add_mutually_exclusive_group())


class Parser(argparse.ArgumentParser):
    """
    The parser of a command.

    Attributes:
        about: what the command does, in a line.
        arguments: title of --help -> the arguments below it, as argparse has them.
        commands: name -> the parser of a command below this one.
    """

    def __init__(self, about: str = "", **options: Any) -> None:
        # The beginning of an option is refused: --count would be taken for --count-from-1. argparse
        # makes a formatter for each argument, which would import three compressors for the width.
        formatter = partial(argparse.HelpFormatter, width=80)
        super().__init__(allow_abbrev=False, add_help=False, formatter_class=formatter, **options)
        self.about = about
        self.arguments: dict[str, list[Any]] = {POSITIONAL: [], OPTIONS: []}
        self.commands: dict[str, Parser] = {}
        text = "-h --help\n  show this help message and exit\n--help-all\n  show rare options, too"
        whole = partial(Parser.format_help, shows_all=True)
        texts = {"help": Parser.format_help, "help_all": whole}
        declare(self, text, **{at: {"action": Printing, "text": texts[at]} for at in texts})
        self.set_defaults(parser=self)

    @property
    def flags(self) -> dict[str, Any]:
        """Each option, as it is typed, and its argument."""
        return {flag: action for action in self._all() for flag in action.option_strings}

    def _all(self) -> list[Any]:
        return [action for group in self.arguments.values() for action in group]

    def group(self, title: str) -> Group:
        return Group(self, title, self.add_argument_group(title))

    def exclusive(self) -> Group:
        """Return a group of options that exclude each other, and have no title of their own."""
        return Group(self, OPTIONS, self.add_mutually_exclusive_group())

    def add_commands(self, metavar: str) -> Callable[..., Parser]:
        """Return the function that adds a command below this one, with its name and `about`."""
        commands = self.add_subparsers(metavar=metavar, required=True, prog=self.prog)
        commands.is_rare = False  # type: ignore[attr-defined]
        self.arguments[POSITIONAL].append(commands)

        def add(name: str, about: str, **options: Any) -> Parser:
            self.commands[name] = commands.add_parser(name, about=about, **options)
            return self.commands[name]

        return add

    def refuse_command(self, word: str) -> NoReturn:
        """Exit with the message that there is no such command, and a similar one."""
        from ..protocol.mistakes import close_to
        from .foreign import COMMANDS as FOREIGN

        close = close_to(word, self.commands)
        if "check" in self.commands and word.endswith((".csv", ".toml", ".md", ".xlsx")):
            close = f"; type {self.prog} check {word}"
        if not close and self.prog != PROGRAM:
            self.error(f"argument ACTION: {_wanted(word, self.commands)}")
        if (other := FOREIGN.get(word)) and not close:
            close = f"; type {PROGRAM} {other}"
        device = f"; a device of this name is read by {PROGRAM} read {word}"
        self.error(f"there is no command {word!r}{close or device}")

    def error(self, message: str) -> NoReturn:
        complain(f"{message} (see {self.prog} --help)")
        self.exit(2)

    def format_usage(self) -> str:
        """Return the line that shows how the command is typed; it names no single options."""
        if self.usage is not None:  # argparse made one before positional arguments were hidden
            return f"usage: {self.usage.strip()}\n"
        needs = [action for action in self._all() if action.required or not action.option_strings]
        words = map(_typed, needs)
        return f"usage: {' '.join([self.prog, '[OPTIONS]', *words])}\n"

    def format_help(self, *, shows_all: bool = False) -> str:
        """Return the help with default values, and without rare options unless all are shown."""
        groups = self.arguments.values()
        rare = [[row.option_strings[0] for row in group if row.is_rare] for group in groups]
        flags = [names[0] for names in rare if names]
        some = ", ".join(dict.fromkeys([*flags[:1], *flags[-1:]]))
        sections: dict[str, list[tuple[str, str]]] = {title: [] for title in self.arguments}
        for title, group in self.arguments.items():
            for action in group:
                text = _help(action)
                if action.dest == "help_all":
                    text = f"{text}: {some}, ..."
                if some if action.dest == "help_all" else shows_all or not action.is_rare:
                    sections[title].append((f"  {_typed(action, in_list=True)}", text))
                if action.dest == argparse.SUPPRESS:  # the commands
                    rows = [(f"    {name}", row.about) for name, row in self.commands.items()]
                    sections[title] += rows
        heads = [head for rows in sections.values() for head, _ in rows]
        column = min(max(map(len, heads)) + 2, HELP_COLUMN)
        parts = [self.format_usage(), self.description or ""]
        for title, rows in sections.items():
            if rows:
                lines = [line for head, text in rows for line in _lines(head, text, column)]
                parts.append("\n".join([f"{title}:", *lines]))
        return "\n\n".join(part.strip("\n") for part in [*parts, self.epilog or ""] if part) + "\n"


class Printing(argparse.Action):
    """An option such as --help that prints the `text` of a parser and exits."""

    # argparse itself would ignore a full disk when printing.
    def __init__(self, *names: Any, text: Callable[[Parser], str], **options: Any) -> None:
        super().__init__(*names, **{**options, "nargs": 0})
        self._text = text

    def __call__(self, parser: Any, *_: Any) -> None:
        print(self._text(parser), end="")
        parser.exit()


def _typed(argument: Any, *, in_list: bool = False) -> str:
    """Return an argument as it is typed: in the usage line, or in the list, with all its names."""
    flags, nargs = argument.option_strings, argument.nargs
    name = argument.metavar
    if nargs == argparse.PARSER:
        return name if in_list else f"{name} ..."
    if in_list and not flags:
        return str(name)
    forms = {"?": f"[{name}]", "*": f"[{name} ...]", "+": f"{name} [{name} ...]", 0: ""}
    value = " ".join(name) if isinstance(name, tuple) else forms.get(nargs, name)
    return f"{', '.join(flags if in_list else flags[-1:])} {value}".strip()


def _help(argument: Any) -> str:
    """Return the text of an argument with its default value."""
    usual = getattr(argument, "usual", dict)().get(argument.dest)
    if usual is None or isinstance(usual, bool):
        return str(argument.help or "")
    return f"{argument.help} ({f'{usual:g}' if isinstance(usual, float) else usual})"


def _lines(head: str, text: str, column: int) -> Iterator[str]:
    """Yield the lines of an argument, as wide as the terminal; its text begins at a column."""
    from textwrap import wrap

    columns = os.environ.get("COLUMNS", "")
    try:
        width = int(columns) if columns.isdecimal() else os.get_terminal_size(1).columns or 80
    except OSError:
        width = 80
    lines = wrap(text, max(width - 2 - column, 11))
    if len(head) > column - 2 or not lines:
        yield head
    else:
        yield f"{head:<{column}}{lines.pop(0)}"
    for line in lines:
        yield f"{'':<{column}}{line}"


# --- declarations -------------------------------------------------------------------------------


def declare(
    target: Parser | Group,
    text: str,
    usual: Callable[[], Mapping[str, Any]] | None = None,
    /,
    **more: Any,
) -> None:
    """
    Add arguments to a parser or a group of one, from a text as --help shows it::

        URL                     a line that is not indented names an argument
            its help            and indented lines below it are its help
        [URL ...]               any number of words
        --quick                 a switch
        -o --output FILE        an option with a value, or with two
        --watch [SECONDS]       an option whose value may be missing
        --group NAME ...        an option that may be repeated
        rare --encoding E       an option that --help-all shows only

    `more` has what else argparse takes, by the name of an argument, and `complete`: the words that
    complete it, or a function of them. --help adds the default values that `usual` returns. An
    URL, N and S are converted, see `TYPES`.
    """
    for block in re.split(r"\n(?=\S)", text.strip()):
        head, _, help = block.partition("\n")
        usage = head.removeprefix("rare ")
        flags, options = _shape(usage)
        if options.get("metavar") in TYPES:
            options["type"] = TYPES[options["metavar"]]
        options |= {"help": " ".join(help.split()), **more.get(options["dest"], {})}
        words = options.pop("complete", None)
        if choices := options.pop("choices", None):
            words, options["type"] = choices, partial(_choice, choices)
        if "metavar" in options:
            options["type"] = _converting(options.get("type", str))
        usual_title = OPTIONS if flags else POSITIONAL
        group = target if isinstance(target, Group) else Group(target, usual_title, target)
        action = group.container.add_argument(*(flags or [options.pop("dest")]), **options)
        group.parser.arguments.setdefault(group.title, []).append(action)
        action.is_rare = head != usage
        if usual is not None:
            action.usual = usual
        if words is not None:
            action.completer = words if callable(words) else lambda words=words, **_: words


def _shape(head: str) -> tuple[list[str], dict[str, Any]]:
    """Return the flags of an argument declared by a line, and its arguments for argparse."""
    match = _HEAD.fullmatch(head)
    assert match is not None
    flags, value, is_many = match["flags"].split(), match["value"], bool(match["many"])
    if is_optional := value.startswith("[") and value.endswith("]"):
        is_many, value = value.endswith(" ...]"), value[1:-1].removesuffix(" ...")
    words = value.split()
    name = next((flag[2:] for flag in flags if flag[:2] == "--"), words[0].lower() if words else "")
    options: dict[str, Any] = {"dest": name.replace("-", "_"), "metavar": value}
    if not flags:
        options["nargs"] = ("*" if is_many else "?") if is_optional else "+" if is_many else None
    elif not value:
        options = {"dest": options["dest"], "action": "store_true"}
    elif is_many:
        options["action"] = "append"
    elif is_optional:
        options["nargs"] = "?"
    elif words[1:]:
        options |= {"metavar": tuple(words), "nargs": len(words)}
    return flags, options


TYPES: dict[str, Callable[[str], Any]] = {"URL": place, "N": int, "S": float}
"""Placeholder of a value in --help -> the function that converts the value."""

_HEAD = re.compile(r"(?P<flags>(?:-[-\w]+(?: |$))*)(?P<value>.*?)(?P<many> \.\.\.)?")

_NEGATIVE = re.compile(r"-(\.?[0-9]|inf|nan)", re.IGNORECASE)


def shield_negatives(words: Iterable[str]) -> list[str]:
    """Put a space before -1e5 and -inf, which argparse would else take for options."""
    return [f" {word}" if _NEGATIVE.match(word) else word for word in words]


def _converting(convert: Callable[[str], Any]) -> Callable[[str], Any]:
    """Return a function that converts a word as it was typed."""

    @wraps(convert)
    def converted(text: str) -> Any:
        return convert(text[1:] if text[:1] == " " and _NEGATIVE.match(text, 1) else text)

    return converted


def _choice(choices: Collection[str], text: str) -> str:
    if text not in choices:
        raise argparse.ArgumentTypeError(_wanted(text, choices))
    return text


def _wanted(word: str, choices: Collection[str]) -> str:
    """Return the message about a word that is not a choice, which names a close one."""
    from ..protocol.mistakes import close_to

    return f"must be one of {', '.join(choices)}, not {word!r}{close_to(word, choices)}"
