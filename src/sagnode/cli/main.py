"""``sagnode``: finds the command, imports it alone, and turns every failure into one clear line and an exit code.

Exit codes: 0 fine, 1 degraded or failed, 2 usage or bad configuration, 70 a defect of sagnode itself, 130 interrupted.

A command is a module with ``DESCRIPTION``, ``add_arguments(parser)`` and ``run(args) -> int``; it may have an
``EPILOG`` for its help, and ``arrange(words) -> words`` to put its words in order before they are parsed. Nothing is
imported for ``--version`` and ``--help``, and a command imports only what it uses, so that ``sagnode status`` answers
at once on a Raspberry Pi.
"""

from __future__ import annotations

import argparse
import difflib
import errno
import importlib
import io
import json
import os
import sys
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol, cast

from sagnode import __version__
from sagnode.errors import ConfigError, SagnodeError

EXIT_OK = 0
EXIT_DEGRADED = 1
EXIT_USAGE = 2
EXIT_DEFECT = 70  # EX_SOFTWARE of sysexits.h
EXIT_INTERRUPTED = 130
EXIT_PIPE_CLOSED = 141

_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO})

# Group, then (name, one line). The line stands here and not in the module, so that --help imports none of them.
COMMANDS: tuple[tuple[str, tuple[tuple[str, str], ...]], ...] = (
    (
        "Operate a node",
        (
            ("run", "measure and publish on schedule, until stopped (what the service runs)"),
            ("status", "what the node is doing: last readings, camera, broker, disk, clock"),
            ("doctor", "look a node over: configuration, camera, disk, broker, clock, watchdog"),
            ("history", "list readings out of the journal"),
            ("export", "write readings out of the journal as CSV or JSON lines"),
        ),
    ),
    (
        "Set one up",
        (
            ("plan", "what accuracy a camera, a lens and a place would give, before anyone climbs"),
            ("config", "write, check and show the configuration"),
            ("calibrate", "intrinsics of a camera from pictures of a calibration board"),
            ("capture", "take pictures with the configured camera"),
        ),
    ),
    (
        "Measure on pictures",
        (
            ("measure", "sag and clearance on pictures of a configured span"),
            ("replay", "measure stored frames again: readings as JSON lines, and how they compare"),
            ("fit", "trace one conductor between two points of any photograph"),
        ),
    ),
    (
        "Look around",
        (
            ("demo", "a simulated day of one span: the real daemon, a broker, a plot"),
            ("scene", "render frames of a span with the truth beside them"),
            ("schema", "JSON Schemas of the messages and of the configuration"),
        ),
    ),
)
NAMES: tuple[str, ...] = tuple(name for _, commands in COMMANDS for name, _ in commands)


class Command(Protocol):
    """What a command's module offers."""

    DESCRIPTION: str

    def add_arguments(self, parser: argparse.ArgumentParser) -> None:
        """Declare the command's own arguments."""

    def run(self, args: argparse.Namespace) -> int:
        """Do it; returns the exit code."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code.

    Args:
        argv: the words after ``sagnode``; default: the process's own.
    """
    words = list(sys.argv[1:] if argv is None else argv)
    _make_streams_sound()
    try:
        code = _dispatch(words)
        sys.stdout.flush()
    except SystemExit as exit_:  # argparse has said what it had to say
        return exit_.code if isinstance(exit_.code, int) else EXIT_USAGE
    except SagnodeError as error:
        _print_error(error)
        if "--json" in words:
            _print_json(error)
        return EXIT_USAGE if isinstance(error, ConfigError) else EXIT_DEGRADED
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader (head, less) has seen enough; the interpreter would complain once more when it flushes.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_PIPE_CLOSED
    except OSError as error:
        if error.errno not in _NO_ROOM or error.filename is not None:
            return _print_defect(error)
        print(f"sagnode: error: cannot write to standard output: {error.strerror}", file=sys.stderr)
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_DEGRADED
    except Exception as error:  # noqa: BLE001 - the outermost frame: a user gets a line, not a traceback
        return _print_defect(error)
    return code


def _make_streams_sound() -> None:
    """Standard streams that were closed lead nowhere; signs that its encoding lacks become question marks."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # the lowest number that is free is the stream's own: no picture and no journal shall have it
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")


def _dispatch(words: list[str]) -> int:
    if not words:
        print(help_text(), file=sys.stderr)
        return EXIT_USAGE
    name, *rest = words
    if name in {"-h", "--help", "help"}:
        if name == "help" and rest:
            return _dispatch([rest[0], "--help"])
        print(help_text())
        return EXIT_OK
    if name in {"-V", "--version", "version"}:
        print(f"sagnode {__version__}")
        return EXIT_OK
    if name not in NAMES:
        print(f"sagnode: error: {_unknown(name)}", file=sys.stderr)
        return EXIT_USAGE
    command = cast(Command, importlib.import_module(f"sagnode.cli.{name}"))
    arrange = getattr(command, "arrange", list)
    return command.run(parser_of(name, command).parse_args(arrange(rest)))


def parser_of(name: str, command: Command) -> argparse.ArgumentParser:
    """What understands a command's own words."""
    parser = argparse.ArgumentParser(
        prog=f"sagnode {name}",
        description=command.DESCRIPTION,
        epilog=getattr(command, "EPILOG", None),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    command.add_arguments(parser)
    return parser


def help_text() -> str:
    """The text of ``sagnode --help``."""
    width = max(len(name) for name in NAMES)
    lines = [
        "usage: sagnode COMMAND ...      sagnode COMMAND --help      sagnode --version",
        "",
        "Measures sag and ground clearance of power-line conductors with one camera.",
    ]
    for title, commands in COMMANDS:
        lines += ["", f"{title}:", *(f"  {name:<{width}}  {line}" for name, line in commands)]
    lines += ["", "exit codes: 0 fine, 1 degraded or failed, 2 usage or bad configuration, 70 a defect in sagnode"]
    return "\n".join(lines)


def _unknown(name: str) -> str:
    if name.startswith("-"):
        return f"unknown option {name}; sagnode --help lists the commands, and options come after one"
    near = difflib.get_close_matches(name, NAMES, n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    return f"unknown command '{name}'; {hint}sagnode --help lists them all"


def _print_error(error: SagnodeError) -> None:
    print(f"sagnode: error: {error.what}", file=sys.stderr)
    if isinstance(error, ConfigError) and error.faults != (error.what,):
        for fault in error.faults:
            print(f"  {fault}", file=sys.stderr)
    if error.remedy:
        print(f"remedy: {error.remedy}", file=sys.stderr)
    _print_details(error)


def _print_json(error: SagnodeError) -> None:
    """The same for the program that asked for JSON, so that it finds a document in every case."""
    faults = list(error.faults) if isinstance(error, ConfigError) else [error.what]
    document = {"schema_version": "sagnode.error/1", "error": error.what, "remedy": error.remedy, "faults": faults}
    print(json.dumps(document, indent=2, ensure_ascii=False), flush=True)


def _print_defect(error: Exception) -> int:
    own = [frame for frame in traceback.extract_tb(error.__traceback__) if "sagnode" in Path(frame.filename).parts]
    place = f" (at {Path(own[-1].filename).name}:{own[-1].lineno})" if own else ""
    print(f"sagnode: error: unexpected {type(error).__name__}: {error}{place}", file=sys.stderr)
    print("remedy: this is a defect; run again with SAGNODE_DEBUG=1 for the details to report", file=sys.stderr)
    _print_details(error)
    return EXIT_DEFECT


def _print_details(error: Exception) -> None:
    if os.environ.get("SAGNODE_DEBUG", "") not in {"", "0"}:
        traceback.print_exception(error, file=sys.stderr)
