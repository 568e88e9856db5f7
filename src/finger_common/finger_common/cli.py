# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Conventions of all commands: exit codes, error lines, help with an example.

Exit codes: 0 done; 1 done, but a check it made fails or part of a file could not be
read; 2 bad input; 128 + n ended by signal n (130 Ctrl-C, 143 SIGTERM, 129 SIGHUP).
"""

from __future__ import annotations

import argparse
import errno
import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NoReturn

from .entry import EXIT_INTERRUPTED as EXIT_INTERRUPTED
from .errors import FingerError, nearest
from .settings import S, Settings

EXIT_LOST = 1
"""Something that a bag holds could not be read; the rest was."""

EXIT_BAD_INPUT = 2

_OUTSIDE = {
    errno.ENAMETOOLONG,
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EFBIG,
    errno.ELOOP,
    errno.EIO,
}
"""Errors of the operating system that no check before can exclude: bad input, no defect."""

DROPPED_AGAIN = 0.1
"""s after which a signal comes again whose exception was dropped."""


_PATHS = {"BAG", "CSV", "DIR", "FILE", "FIT", "IMAGE", "NPZ", "PNG", "VIEW", "YAML"}
"""Metavars of arguments that name files or folders."""


class Formatter(argparse.RawDescriptionHelpFormatter):
    """Wraps descriptions and keeps the lines of an example."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if "\n" in text:
            return super()._fill_text(text, width, indent)
        return argparse.HelpFormatter._fill_text(self, text, width, indent)


class Parser(argparse.ArgumentParser):
    """ArgumentParser that keeps the layout of an example given as epilog, never abbreviates
    options, names the option or command that was probably meant, and completes in a shell.
    """

    def __init__(self, *args: object, example: str | None = None, **kwargs: object) -> None:
        kwargs.setdefault("formatter_class", Formatter)
        kwargs.setdefault("allow_abbrev", False)
        if example is not None:
            kwargs["epilog"] = "example:\n  " + example.strip().replace("\n", "\n  ")
        super().__init__(*args, **kwargs)  # type: ignore[arg-type]

    def parse_args(self, *args: Any, **kwargs: Any) -> Any:
        """As in the base class; answers the shell first when it asks for completions."""
        if "_ARGCOMPLETE" in os.environ:
            import argcomplete

            argcomplete.autocomplete(self)
        return super().parse_args(*args, **kwargs)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As in the base class; remembers what was given, for `error`."""
        self._given = list(sys.argv[1:] if args is None else args)
        return super().parse_known_args(args, namespace)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """As in the base class; refuses an empty name, as of a shell's variable that is not
        set."""
        if "" in arg_strings and (action.metavar in _PATHS or "--output" in action.option_strings):
            text = "the name is empty; give one (is a variable of the shell not set?)"
            raise argparse.ArgumentError(action, text)
        return super()._get_values(action, arg_strings)  # type: ignore[misc]

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """As in the base class; says how a number is written."""
        try:
            return super()._get_value(action, arg_string)  # type: ignore[misc]
        except argparse.ArgumentError:
            if action.type not in (int, float, integer):
                raise
            form = "a decimal point" if action.type is float else "digits alone"
            whole = "" if action.type is float else "whole "
            text = f"'{arg_string}' is no {whole}number; write it with {form} and without a unit"
            raise argparse.ArgumentError(action, text) from None

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """As in the base class; the default is a choice too, such as an empty one that the help
        does not list."""
        if value != action.default:
            super()._check_value(action, value)  # type: ignore[misc]

    def format_usage(self) -> str:
        """What must be given; the options are listed below in the help."""
        needed = [a for a in self._actions if a.required or not a.option_strings]
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, needed, [])
        optional = " [options]" if len(self._actions) > len(needed) + self.add_help else ""
        return formatter.format_help().replace(self.prog, self.prog + optional, 1)

    def format_help(self) -> str:
        """As in the base class, with the short usage."""
        _, _, rest = super().format_help().partition("\n\n")
        return f"{self.format_usage()}\n{rest}"

    def error(self, message: str) -> NoReturn:
        """End with exit code 2; a misspelt option or name gets the one that was meant."""
        if message.startswith("the following arguments are required"):
            # A misspelt option comes first: what is missing may follow from it.
            known = {"--", *self._all_options()}
            words = [w for w in self._given if w.startswith("--") and w.split("=")[0] not in known]
            message = f"unrecognized arguments: {words[0]}" if words else message
        unknown = re.match(r"unrecognized arguments: (-\S+)", message)
        choice = re.search(r"invalid choice: '?([^' ]*)'? \(choose from (.*)\)", message)
        near = None
        if unknown:
            given = unknown[1].split("=")[0]
            options = {option.lstrip("-"): option for option in self._all_options()}
            options.pop(given.lstrip("-"), None)  # known, but not in this place
            found = nearest(given.lstrip("-"), options)
            near = None if found is None else options[found]
        elif choice:
            near = nearest(choice[1], re.findall(r"[^', ]+", choice[2]))
        super().error(message if near is None else f"{message}; did you mean '{near}'?")

    def _all_options(self) -> list[str]:
        """Options of this command and of the subcommand in use; of all, where none is named."""
        found = list(self._option_string_actions)
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                named = [action.choices[word] for word in self._given if word in action.choices]
                for parser in named[:1] or action.choices.values():
                    found += parser._option_string_actions
        return found


def integer(text: str) -> int:
    """Whole number in decimal, or with 0x in hexadecimal."""
    return int(text, 16) if text.lower().startswith("0x") else int(text)


class _Listed(argparse.Action):
    """A list in place of the default; the option given again adds to it."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,
    ) -> None:
        before = getattr(namespace, self.dest)
        setattr(namespace, self.dest, [*(() if before is self.default else before), *values])


def add_settings(parser: Any, cls: type[Settings], without: str = "") -> None:
    """Give a parser, or a group of one, an option ``--the-name`` for every field of a settings
    class, under the heading of the field's group.

    without: name of a field that gets no option.
    """
    whole, groups = parser, {"": parser}
    for item in cls.parameters():
        if item.name == without:
            continue
        if item.group not in groups:
            groups[item.group] = whole.add_argument_group(item.group)
        parser = groups[item.group]
        flag = "--" + item.name.replace("_", "-")
        allowed = "" if item.choices is not None else item.range_text()
        # A range names the unit already.
        note = f" [{allowed or item.unit}]" if allowed or item.unit else ""
        default = _default_text(item.default)
        note += f" (default: {default})" if default else ""
        meaning = f"{item.meaning}{note}".replace("%", "%%")
        if isinstance(item.default, bool):
            # Some versions of Python add "(default: True)" to a help that they are given here.
            parser.add_argument(
                flag, action=argparse.BooleanOptionalAction, default=item.default
            ).help = meaning
        elif isinstance(item.default, list):
            parser.add_argument(
                flag,
                action=_Listed,
                nargs="*",
                type=type(item.default[0]) if item.default else str,
                default=item.default,
                choices=item.choices,
                metavar=None if item.choices else item.name.upper(),
                help=meaning,
            )
        else:
            choices = item.choices
            if item.default == "" and choices:
                choices = tuple(choice for choice in choices if choice)
            shown = item.name.upper() if isinstance(item.default, str) else "VALUE"
            parser.add_argument(
                flag,
                type=integer if type(item.default) is int else type(item.default),
                default=item.default,
                choices=choices,
                metavar=None if choices else shown,
                help=meaning,
            )


def _default_text(value: Any) -> str:
    """A default as the help shows it; empty for an empty one."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) if isinstance(value, list) else str(value)


def settings_from(arguments: argparse.Namespace, cls: type[S]) -> S:
    """Settings from parsed options; raises InputError for a value outside its range."""
    return cls(**{p.name: getattr(arguments, p.name) for p in cls.parameters()})


def plain(text: object, longest: int = 1000) -> str:
    """Text from outside for a terminal: what cannot be printed is escaped, the middle of
    a long one left out.
    """
    shown = str(text)
    if len(shown) > longest:
        shown = f"{shown[: longest // 2]} … {shown[-longest // 3 :]}"
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in shown)


def one_line(error: BaseException) -> str:
    """The error's message folded into one line that any terminal can show."""
    return plain(" ".join(str(error).split())) or type(error).__name__


def print_to_nobody() -> None:
    """The reader of standard output went away: what is still printed, or flushed at exit, is lost
    without an error."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def in_main_thread() -> bool:
    """Whether this is the thread in which Python sets and runs the handlers of signals."""
    return threading.current_thread() is threading.main_thread()


def end_workers() -> None:
    """End the processes of pools, without waiting for what they compute."""
    if (pools := sys.modules.get("multiprocessing")) is not None:  # else there are none
        for worker in pools.active_children():
            worker.terminate()


class _Signalled(BaseException):
    """SIGTERM or SIGHUP, as `timeout`, Slurm, `docker stop` and a closed terminal send them."""

    def __init__(self, number: int) -> None:
        self.number = number


@contextmanager
def _pools_quiet() -> Iterator[None]:
    """A process pool of Python 3.11 that loses its processes gives their error to futures that were
    cancelled too, and its thread ends with InvalidStateError: no report of that."""
    if not in_main_thread():  # of several commands, the first need not be the first to end
        yield
        return
    usual = threading.excepthook

    def report(failed: threading.ExceptHookArgs) -> None:
        pools = sys.modules.get("concurrent.futures")
        if pools is None or failed.exc_type is not pools.InvalidStateError:
            usual(failed)

    threading.excepthook = report
    try:
        yield
    finally:
        threading.excepthook = usual


@contextmanager
def _signals_raised() -> Iterator[None]:
    """SIGTERM and SIGHUP raise _Signalled, so that no half-written file is left; signals that
    somebody handles or ignores stay as they are. A signal whose exception is dropped comes again:
    no exception passes a callback of compiled code, such as that of numba while it loads kernels.
    """
    if not in_main_thread():
        yield
        return
    ended = [signal.SIGTERM, signal.SIGHUP]
    ended = [number for number in ended if signal.getsignal(number) is signal.SIG_DFL]

    def end(number: int, frame: Any) -> None:
        for other in ended:  # a second one must not break the clean-ups
            signal.signal(other, signal.SIG_IGN)
        end_workers()
        raise _Signalled(number)

    usual, again = sys.unraisablehook, threading.Timer(0.0, int)

    def dropped(lost: Any) -> None:
        nonlocal again
        if not isinstance(lost.exc_value, (KeyboardInterrupt, _Signalled)):
            return usual(lost)
        number = getattr(lost.exc_value, "number", signal.SIGINT)
        if isinstance(lost.exc_value, _Signalled):
            signal.signal(number, end)
        again.cancel()
        again = threading.Timer(DROPPED_AGAIN, os.kill, (os.getpid(), number))
        again.daemon = True
        again.start()

    sys.unraisablehook = dropped
    for number in ended:
        signal.signal(number, end)
    try:
        yield
    finally:
        try:
            again.cancel()
            if again.ident is not None:
                again.join()  # what it sends comes here, not after the command
        finally:
            sys.unraisablehook = usual
            for number in ended:
                signal.signal(number, signal.SIG_DFL)


def run(
    main: Callable[[Sequence[str] | None], int | None], argv: Sequence[str] | None = None
) -> int:
    """Run a command's main function and return its exit code.

    A FingerError becomes one line on standard error and exit code 2, as does a file that the
    operating system refuses (name too long, no right, disk full); Ctrl-C gives 130, SIGTERM 143;
    a closed pipe (as in `… | head`) ends quietly. Other exceptions are defects and keep their
    traceback.

    Example: ``sys.exit(run(main))``.
    """
    name = os.path.basename(sys.argv[0]) or "finger"
    for stream in ("stdout", "stderr"):
        if getattr(sys, stream) is None:  # closed by the caller, as by >&-
            setattr(sys, stream, open(os.devnull, "w"))
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # file names need not be text
    try:
        try:
            with _signals_raised(), _pools_quiet():
                return main(argv) or 0
        finally:  # also of --help
            try:
                print(end="", flush=True)
            except BrokenPipeError:
                print_to_nobody()
            except OSError as error:
                print_to_nobody()
                raise OSError(error.errno, error.strerror, "standard output") from None
    except FingerError as error:
        print(f"{name}: {one_line(error)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except OSError as error:
        if isinstance(error, BrokenPipeError):
            print_to_nobody()
            return 0
        if error.errno not in _OUTSIDE:
            raise
        where = plain(error.filename, 200) if error.filename else "a file that it writes"
        print(f"{name}: {where}: {error.strerror}; check name, rights and disk", file=sys.stderr)
        return EXIT_BAD_INPUT
    except KeyboardInterrupt:
        print(f"{name}: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED
    except _Signalled as error:
        print(f"{name}: ended by {signal.Signals(error.number).name}", file=sys.stderr)
        return 128 + error.number
