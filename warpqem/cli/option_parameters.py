"""Parameters of commands from the fields of dataclasses of options, and ``--help-all``."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable, Collection, Mapping
from enum import Enum
from typing import Annotated, Any

import typer

from warpqem.arguments.option_fields import OptionField, named_options
from warpqem.errors import OptionError

__all__ = ["HelpAll", "check_names", "parameter_of", "takes_options"]

KIND = inspect.Parameter.POSITIONAL_OR_KEYWORD


# What options do in full, by the name and the short help of each: --help has the first clause. Options of one name may
# do different things in two commands.
_full_help: dict[tuple[str, str], str] = {}


def _print_all(context: typer.Context, wanted: bool) -> None:
    if wanted:
        for parameter in context.command.params:
            option: Any = parameter
            # What --help shows stands first.
            option.shown_late, option.hidden = getattr(option, "hidden", False), False
            option.help = _full_help.get((option.name, option.help), option.help)
        typer.echo(context.get_help())
        raise typer.Exit


HelpAll = Annotated[
    bool,
    typer.Option("--help-all", is_eager=True, callback=_print_all, help="Show all options and exit."),
]


def takes_options(
    options: type, *, without: Collection[str] = (), only: Collection[str] = (), hidden: Collection[str] = ()
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of a dataclass beside its own; it gets their values by name as `options`.

    Args:
        options: The dataclass, see `warpqem.arguments.option_fields`.
        without: Names of options that it does not take.
        only: Names of those that it takes, and shows all in its help; empty for all others.
        hidden: Names of options that its help leaves to --help-all, whatever they say.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        own = inspect.signature(command, eval_str=True)
        offered = named_options(options)
        taken = {name: offered[name] for name in only or offered if name not in without}
        shared = [parameter_of(entry, basic=_is_shown(entry, only, hidden)) for entry in taken.values()]
        more = any(parameter.annotation.__metadata__[0].hidden for parameter in shared)
        # What has no default comes first, then the shared options, then those of the command.
        kept = [parameter for name, parameter in own.parameters.items() if name != "options"]
        first = [parameter for parameter in kept if parameter.default is parameter.empty]
        last = [parameter for parameter in kept if parameter.default is not parameter.empty]
        if more:
            last.append(inspect.Parameter("help_all", KIND, default=False, annotation=HelpAll))
        parameters = [*first, *shared, *last]

        @functools.wraps(command)
        def wrapper(**arguments: Any) -> None:
            arguments.pop("help_all", None)
            values = {name: _plain(arguments.pop(name)) for name in taken}
            command(**arguments, options=values)

        # Typer reads both.
        wrapper.__signature__ = own.replace(parameters=parameters)  # type: ignore[attr-defined]  # PEP 362
        wrapper.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return wrapper

    return decorate


# What the help shows for the name of a file or a folder.
NAMES = ("IN", "OUT", "[OUT]", "FILE", "PNG", "DIR", "INPUT...", "REFERENCE", "TEST", "SOURCE", "TARGET")


def check_names(parameters: Mapping[str, inspect.Parameter], values: Mapping[str, Any]) -> None:
    """Refuse empty names of files, as a variable of a shell that is not set leaves them.

    Raises:
        OptionError: one is empty; it would stand for the folder of the process.
    """
    for name, parameter in parameters.items():
        about: Any = getattr(parameter.annotation, "__metadata__", (None,))[0]
        given = values.get(name)
        if getattr(about, "metavar", None) in NAMES and (given == "" or (isinstance(given, list) and "" in given)):
            flag = f"`{name}`" if isinstance(about, typer.models.OptionInfo) else about.metavar
            raise OptionError(f"{flag}: the name is empty")


def _is_shown(entry: OptionField, only: Collection[str], hidden: Collection[str]) -> bool:
    return entry.name not in hidden and (bool(only) or entry.option.basic)


def parameter_of(entry: OptionField, basic: bool) -> inspect.Parameter:
    """The parameter of a command that stands for an option."""
    said = entry.option
    name = entry.name.replace("_", "-")
    flag = entry.kind is bool
    # A flag that is off need not be switched off.
    names = [f"--{name}/--no-{name}" if flag and (entry.optional or entry.default) else f"--{name}"]
    text = _first_clause(entry) if basic and said.basic else _help(entry)
    _full_help[entry.name, text] = _help(entry)
    about = typer.Option(*names, metavar=_value_name(entry), help=text, hidden=not basic, rich_help_panel=said.panel)
    default = None if not entry.has_default or said.repeated else entry.default
    annotation = _value_type(entry)
    if default is None or default == ():
        default, annotation = None, annotation | None
    return inspect.Parameter(
        entry.name,
        KIND,
        default=default,
        annotation=Annotated[annotation, about],
    )


def _value_name(entry: OptionField) -> str | None:
    """What the help shows for the value of an option; None for a flag."""
    if entry.kind is bool:
        return None
    choices = entry.literals if entry.option.choices is None else entry.option.choices()
    return "|".join(choices) or entry.option.unit


def _value_type(entry: OptionField) -> Any:
    if entry.option.repeated:
        return list[str]
    if entry.option.choices is not None:
        return Enum(entry.name, {name: name for name in entry.option.choices()}, type=str)
    # Numbers are text here: what reads the options says which numbers one takes, and what to write instead.
    return entry.kind if entry.literals or entry.kind is bool else str


def _plain(value: Any) -> Any:
    return value.value if isinstance(value, Enum) else value


def _first_clause(entry: OptionField) -> str:
    """The beginning of a help up to its first semicolon or period, and the range of a number."""
    clause = entry.option.brief or re.split(r"[;.](?= |$)", entry.option.help, maxsplit=1)[0]
    limits = entry.option.limits
    return f"{clause}." if limits is None else f"{clause} ({limits})."


def _help(entry: OptionField) -> str:
    limits = entry.option.limits
    text = entry.option.help
    # A period that ends the help stands before the range.
    return text if limits is None else f"{text} ({limits})"
