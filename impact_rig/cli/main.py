# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Command line of the package: parses the arguments and runs one subcommand; an error becomes one line and exit code 1.

Only the module of the chosen subcommand is loaded, after the signal handlers are installed.
"""

from __future__ import annotations

import codecs
import functools
import io
import itertools
import os
import re
import signal
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from impact_rig.system.endings import Ending

if TYPE_CHECKING:
    import argparse
    from importlib.metadata import EntryPoint

EXIT_ERROR = 1
PROGRAM = "impact-rig"
GROUP = "impact_rig.commands"
"""Entry points through which packages contribute commands: the name, and the function that registers its parser."""
HEADINGS = {
    "See it": ("lab", "demo"),
    "Recordings": ("record", "info", "analyze", "compare", "verify", "replay", "recover", "import", "export"),
    "Drive": ("drive",),
    "Studies": ("campaign", "map", "dynamics", "identify", "report"),
    "Interfaces": ("fmu", "daqmx"),
    "Files": ("check",),
    "Other packages": (),
}
"""Names of commands by the heading under which the help lists them; all others are listed under the last heading."""
HIDDEN = ("interface",)  # installed, but not listed in the help
MOVED = {"loop": "drive", "play": "drive play", "frf": "drive frf"}


@functools.cache
def commands() -> dict[str, EntryPoint]:
    """Return the entry points of the installed subcommands by name, in the order in which the help lists them."""
    from importlib.metadata import entry_points  # noqa: PLC0415  # after the signals are taken

    ordered = (*itertools.chain.from_iterable(HEADINGS.values()), *HIDDEN)
    place = {name: number for number, name in enumerate(ordered)}
    found = sorted(entry_points(group=GROUP), key=lambda one: (place.get(one.name, len(place)), one.name))
    return {one.name: one for one in found}


def command_line(command: str = "") -> argparse.ArgumentParser:
    """Return the parser of the program with its subcommands.

    If `command` is the name of a subcommand, the parser has only this subcommand, which is faster. If `command` is
    `--version`, the parser has no subcommands. Otherwise it has all of them.
    """
    import argparse  # noqa: PLC0415  # after the signals are taken

    import impact_rig  # noqa: PLC0415

    parser = argparse.ArgumentParser(
        prog=PROGRAM,
        usage=f"{PROGRAM} [-h] [--version] COMMAND ...",
        description="Virtual vibration test rig of an impact damper: run it, record it, and analyse its recordings.",
        epilog="example: impact-rig lab --sample\n`impact-rig COMMAND --help` shows examples of a command.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "--version", action="version", version=f"{PROGRAM} {impact_rig.__version__}", help="show the version and exit"
    )
    registered = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND", prog=PROGRAM, help=argparse.SUPPRESS
    )
    known = commands() if command != "--version" else {}
    for name in [command] if command in known else known:
        known[name].load()(registered)
    listed = {one.dest: one for one in registered._choices_actions if one.dest not in HIDDEN}
    for heading, names in HEADINGS.items():
        named = [listed.pop(name) for name in names if name in listed]
        parser.add_argument_group(heading)._group_actions += named
    parser._action_groups[-1]._group_actions += listed.values()
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `impact-rig` and return the exit code.

    Args:
        arguments: words of the command line without the program's name. None means those of this process; then
            SIGINT and SIGTERM end the command in an orderly way, and a shell's request for completions is answered.

    Raises:
        SystemExit: the words are not a valid command line (code 2), or ask for help or the version (code 0).
    """
    if arguments is not None:
        return _run(_parse(arguments), None)
    words = sys.argv[1:]
    if isinstance(sys.stdout, io.TextIOWrapper):
        codecs.register_error(PROGRAM, _encodable)
        sys.stdout.reconfigure(errors=PROGRAM)
    if "_ARGCOMPLETE" in os.environ:
        _complete()
    ending = Ending(PROGRAM)
    if words and words[0].isalpha():  # it takes a while to find out whether it is a command
        ending.name = f"{PROGRAM} {words[0]}"
    chosen = _parse(words)
    if getattr(chosen, "ends_by_signal", False):  # a signal is its normal end
        ending.code = lambda _number: 0
    return ending.run(lambda: _run(chosen, ending))


def _encodable(error: UnicodeError) -> tuple[bytes, int]:
    r"""Return bytes for characters that stdout cannot encode, and the index at which encoding continues.

    This is an error handler for `codecs.register_error`. Bytes of a file name that is not UTF-8 stay unchanged. Other
    characters are written as in JSON, `±` as `\u00b1`. Errors other than encoding errors are raised again.
    """
    if not isinstance(error, UnicodeEncodeError):
        raise error
    units = error.object[error.start : error.end].encode("utf-16-be", "surrogatepass").hex()
    text = "".join(f"\\u{units[k : k + 4]}" for k in range(0, len(units), 4))
    return re.sub(r"\\udc([89a-f].)", lambda found: chr(int(found[1], 16)), text).encode("latin-1"), error.end


def _parse(arguments: Sequence[str]) -> argparse.Namespace:
    first = arguments[0] if arguments else ""
    parser = command_line(first)
    if first and not first.startswith("-") and first not in (known := commands()):
        from impact_rig.errors import did_you_mean  # noqa: PLC0415
        from impact_rig.names import visible  # noqa: PLC0415

        if first in MOVED:
            parser.error(f"{first!r} is now `{PROGRAM} {MOVED[first]}`: use that command")
        hint = did_you_mean(first, known, f"did you mean `{PROGRAM} {{}}`?", f"the commands are {', '.join(known)}")
        parser.error(visible(f"{first!r} is not a command: {hint}"))
    return parser.parse_args(arguments)


def _complete() -> None:
    """Answer a shell's request for completions and exit.

    Return normally if there is no request, or if argcomplete is not installed.
    """
    try:
        import argcomplete  # noqa: PLC0415  # an extra
    except ImportError:
        return
    words = os.environ.get("COMP_LINE", "").split()
    argcomplete.autocomplete(command_line(words[1] if len(words) > 1 else ""))


def _run(chosen: argparse.Namespace, ending: Ending | None) -> int:
    from impact_rig.errors import ImpactRigError  # noqa: PLC0415
    from impact_rig.names import one_line, visible  # noqa: PLC0415

    try:
        if getattr(chosen, "needs_ros", lambda _arguments: False)(chosen):
            from impact_rig.system.extras import load_ros  # noqa: PLC0415

            load_ros("impact_rig.driver.ros_rig", chosen.command)  # before the command creates anything
        result: int = chosen.run(chosen)
        sys.stdout.flush()
    except ImpactRigError as error:
        if ending is None or not ending.received:  # otherwise the error is a consequence of the signal
            about_content = isinstance(error, (ValueError, OSError))  # not the last lines of a process that died
            text = one_line(str(error), lines=not about_content)
            print(f"{PROGRAM} {chosen.command}: {text}", file=sys.stderr)  # noqa: T201  # a command line tool talks
        return EXIT_ERROR
    except OSError as error:
        if ending is not None and ending.received:
            raise
        if isinstance(error, BrokenPipeError):  # the reader of the output has ended, as `head` does
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is still buffered
            return 128 + signal.SIGPIPE
        where = f"{error.filename}: " if error.filename else ""
        print(f"{PROGRAM} {chosen.command}: {visible(where)}{error.strerror or error}", file=sys.stderr)  # noqa: T201
        return EXIT_ERROR
    return result
