"""The command line: ``spiral VERB [names] [KEY=VALUE ...] [--json FILE] [-m] [--plugins DIR]``.

Exit codes: 0 done (also where nothing is missing, or no known effect explains what is); 2 bad
input, reported in one message; 3 a refusal, where the data do not allow an answer. Heavy imports
happen where a verb needs them.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import io
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from spiral.commands import ram
from spiral.commands.perform import perform, perform_sweep_job
from spiral.commands.tracking import log_run_to_mlflow, print_tracking_outcome
from spiral.io.registry import NO_FOLDER
from spiral.io.request import BAD_INPUT, Request
from spiral.types.errors import ConfigError, SpiralError, did_you_mean
from spiral.version import __version__

VERBS = {
    "discover": "find what the model is missing, add it, and repeat: the main job",
    "compare": "fit the model as configured and compare it with data it has not seen",
    "diagnose": "say where the model fails and rank what may be missing; changes nothing",
    "add": "fit the model, then the model plus EFFECT...; before and after side by side",
    "estimate": "reconstruct all states, hidden ones too, with an observer",
    "identify": "before any fit: can the record tell the terms apart? rank, aliases, samples",
    "plan": "rank planned tests: which would tell EFFECT... apart, or reach a standard error",
    "simulate": "make a record from a model and write it to a file",
    "app": "the page on 127.0.0.1: see where the model fails, click Add, watch the error fall",
    "report": "one HTML file of a saved run (run=ID, by default the latest), figures and all",
    "export": "the model of a saved run as a program or a text: export RUN --to KIND",
    "plugins": "list systems, effects and sources",
    "check": "verify a plugin or a model: units, derivatives, behaviour at rest",
    "new": "write a working skeleton of a plugin and its test: new KIND NAME",
}

_LISTED = 3  # plugin files named before a command, the rest as a number
_PLAIN = ("app", "report", "export", "plugins", "check", "new")  # verbs without a configuration

_EPILOG = """\
first steps:
  spiral discover experiment=rotor_coastdown
  spiral compare  experiment=rotor_coastdown
  spiral diagnose experiment=rotor_coastdown
  spiral add cubic_stiffness run=latest

your own data:
  spiral discover system=planar_rotor record=csv record.path=a.csv record.time=t \\
      record.channels='{x: ch1, y: ch2}' record.inputs='{speed: rpm}' \\
      record.units='{x: um, y: um, speed: rpm}'

your own physics, in ./plugins or --plugins DIR:
  spiral new effect my_spring
  spiral check my_spring

KEY=VALUE are Hydra overrides: system= record= test= effect=[a,b] experiment= choose by name,
record.FIELD=VALUE sets a field; with -m, KEY=a,b,c runs once for each value.
"""


class _Parser(argparse.ArgumentParser):
    """An argument parser that raises ``ConfigError`` where its input is wrong."""

    def error(self, message: str) -> NoReturn:
        """Raise instead of printing a usage and exiting."""
        raise ConfigError(message, f"{self.prog} as in its --help", f"{self.prog} --help")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the program; returns its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    target = _json_target(given)
    try:
        options = _parse_arguments(given)
        if options.verb is None:
            parser().print_help()
            return 0
        _announce_local_plugins(options)
        if getattr(options, "help", False):
            return _verb_help(options)
        request = _request(options)
        if request.verb not in ("plugins", "new"):
            ram.check_memory_limit()
        if options.verb == "app":
            return _run_app(request, options.port, not options.no_browser, options.token)
        if options.multirun:
            return _run_multirun(request, options.json)
        return _run_single(request, options.json)
    except SpiralError as error:
        return _print_error(error, target)
    except MemoryError:
        return _print_error(ram.out_of_memory_error(), target)
    except KeyboardInterrupt:
        print("stopped", file=sys.stderr)
        return 130
    except RuntimeError as error:  # Python 3.11 wraps what interrupts the making of a class
        if not isinstance(error.__cause__, KeyboardInterrupt | SystemExit):
            raise
        print("stopped", file=sys.stderr)
        return 130
    except BrokenPipeError:  # as in: spiral plugins | head -1
        _discard_stdout()
        return 0


def entry() -> NoReturn:
    """Run the program and end the process without a final garbage collection (1 to 2 s)."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # its encoding may lack characters that we write
    if not sys.warnoptions:  # NumPy's of a model that runs away: the result says so in words
        warnings.simplefilter("ignore", RuntimeWarning)
    signal.signal(signal.SIGTERM, _exit_on_sigterm)
    code = main()
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _discard_stdout()
    gc.freeze()
    sys.exit(code)


def _exit_on_sigterm(number: int, frame: object) -> NoReturn:
    """Exit on SIGTERM as on Ctrl-C: unfinished files are removed, worker processes ended."""
    print("stopped", file=sys.stderr)
    raise SystemExit(128 + number)


def _discard_stdout() -> None:
    """Send the rest of standard output to the null device: its reader has closed the pipe."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def parser() -> argparse.ArgumentParser:
    """The verbs and their options."""
    top = _Parser(
        prog="spiral",
        description="Find the physics that a model is missing, from measurements.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"spiral {__version__}")
    verbs = top.add_subparsers(dest="verb", metavar="VERB", parser_class=_Parser)
    for name, meaning in VERBS.items():
        verb = verbs.add_parser(
            name,
            help=meaning,
            description=meaning[0].upper() + meaning[1:] + ".",
            epilog=_EPILOG,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            add_help=name in _PLAIN,
        )
        _add_verb_options(verb, name)
    return top


def _add_verb_options(verb: argparse.ArgumentParser, name: str) -> None:
    """The options of one verb."""
    if name not in _PLAIN:
        verb.set_defaults(parser=verb)
        words = "this help with the options of each group; with GROUP or NAME, its fields"
        verb.add_argument("-h", "--help", action="store_true", help=words)
    verb.add_argument("words", nargs="*", metavar="NAME|KEY=VALUE", help="names and overrides")
    verb.add_argument("--json", metavar="FILE", help="write the result as JSON; - is stdout")
    own = verb.add_mutually_exclusive_group()
    own.add_argument("--plugins", metavar="DIR", help="folder with plugins of your own")
    own.add_argument(
        "--no-plugins", dest="plugins", action="store_const", const=NO_FOLDER,
        help="run no file of ./plugins or SPIRAL_PLUGINS",
    )  # fmt: skip
    if name == "app":
        verb.add_argument("--port", metavar="N", help="port to listen on; usually 8765")
        verb.add_argument("--no-browser", action="store_true", help="open no browser")
        words = "the page's token, for scripts; better in SPIRAL_TOKEN, which no other user sees"
        verb.add_argument("--token", metavar="TOKEN", help=words)
    if name == "report":
        verb.add_argument("--out", metavar="FILE", help="the page to write: .html")
    if name == "export":
        from spiral.io.export.kinds import KINDS

        kinds = "; ".join(f"{kind}: {k.meaning}" for kind, k in KINDS.items())
        verb.add_argument("--to", metavar="KIND", help=kinds)
        verb.add_argument("--out", metavar="FILE", help="the file to write; else beside the run")
    if name in ("simulate", "estimate"):
        verb.add_argument("--out", metavar="FILE", help="the table to write: .csv or .parquet")
    if name not in (*_PLAIN, "simulate"):
        verb.add_argument(
            "-m", "--multirun", action="store_true", help="run once for each swept value"
        )


def _parse_arguments(given: list[str]) -> argparse.Namespace:
    if given and not given[0].startswith("-") and given[0] not in VERBS:
        raise ConfigError(
            f"spiral {given[0]}", f"a verb: {', '.join(VERBS)}", did_you_mean(given[0], VERBS)
        )
    top = parser()
    options, rest = top.parse_known_args(given)
    for word in rest:
        if word.startswith("-"):
            raise ConfigError(
                f"option {word!r}",
                f"an option of spiral {options.verb}",
                f"spiral {options.verb} --help",
            )
    if options.verb is not None:
        options.words = [*options.words, *rest]
        options.multirun = getattr(options, "multirun", False)
    return options


def _verb_help(options: argparse.Namespace) -> int:
    """The verb's own help with the options of each group, or what is in the groups named."""
    from spiral.view.terminal.grouphelp import groups_help

    help_text = groups_help(options.plugins, options.words)
    if not options.words:
        options.parser.epilog = f"{help_text}\n\n{_EPILOG}"
        help_text = options.parser.format_help()
    print(help_text.rstrip())
    return 0


def _announce_local_plugins(options: argparse.Namespace) -> None:
    """Say on standard error which local files this command runs as plugins, before it does.

    A folder that does not exist is reported by the verb itself (``spiral new`` creates it).
    """
    from spiral.io.registry import local_sources
    from spiral.types.formatting import first_words

    if options.verb == "report":  # loads no plugins
        return
    with contextlib.suppress(ConfigError):
        files = local_sources(options.plugins)
        if files:
            listed = first_words([str(f) for f in files], _LISTED)
            print(f"spiral: runs local plugins: {listed} (--no-plugins: without)", file=sys.stderr)


def _json_target(given: list[str]) -> str | None:
    """The file after ``--json``, read without the parser: errors of the parser go there too."""
    for index, word in enumerate(given):
        if word.startswith("--json="):
            return word.partition("=")[2]
        if word == "--json" and index + 1 < len(given):
            return given[index + 1]
    return None


def _request(options: argparse.Namespace) -> Request:
    def is_override(word: str) -> bool:
        return "=" in word or word.startswith(("~", "+"))

    return Request(
        options.verb,
        names=tuple(w for w in options.words if not is_override(w)),
        overrides=tuple(w for w in options.words if is_override(w)),
        plugins=options.plugins,
        out=getattr(options, "out", None),
        to=getattr(options, "to", None),
    )


def _run_app(request: Request, port: str | None, browser: bool, token: str | None) -> int:
    from spiral.app.serve import start_app

    return start_app(request.names, request.overrides, port, browser, request.plugins, token)


def _run_single(request: Request, target: str | None) -> int:
    from spiral.view.terminal import parts

    with parts.progress_line() as tell:

        def on_round(finished_round: Any) -> None:
            parts.announce_round(finished_round, tell)

        def so_far(result: dict[str, Any]) -> None:
            if target != "-":  # a file has what is known, should the study be stopped
                _write_json(result, target)

        outcome = perform(request, tell, on_round, so_far)
    _write_json(outcome.result, target)
    if target != "-":
        from spiral.view.terminal import estimate, plan, plugins, study

        screens = {v: s for s in (plugins, estimate, plan) for v in s.VERBS}
        screens.get(request.verb, study).show(request.verb, outcome)
    print_tracking_outcome(log_run_to_mlflow(outcome), target)
    return outcome.exit


def _run_multirun(request: Request, target: str | None) -> int:
    from spiral.io.registry import load_registry
    from spiral.io.sweeps.jobs import plan_sweep
    from spiral.io.sweeps.sweep import run_sweep
    from spiral.io.sweeps.tracker import SweepTracker
    from spiral.io.tracking.store import tracking_options
    from spiral.view.report.html import report_html
    from spiral.view.terminal import sweep as screen

    registry = load_registry(request.plugins)
    plan = plan_sweep(request.verb, request.names, request.overrides, request.plugins, registry)
    with screen.sweep_progress_bar() as (tell, watch):
        tracker = SweepTracker(tracking_options(plan.config), plan.out, tell, report_html, registry)
        sweep = run_sweep(perform_sweep_job, plan, tell, watch, tracker.on_row)
        tracked = tracker.finish()
    _write_json(sweep.as_dict(), target)
    if target != "-":
        screen.show(sweep)
    elif sweep.error:
        print("\n".join(f"{k + ':':<10}{v}" for k, v in sweep.error.items()), file=sys.stderr)
    print_tracking_outcome(tracked, target)
    return sweep.exit


def _write_json(result: dict[str, Any], target: str | None) -> None:
    if target is None:
        return
    from pathlib import Path

    from spiral.io.writing import to_json, write_whole

    text = to_json(result) + "\n"
    if target == "-":
        sys.stdout.write(_encodable_json(sys.stdout.encoding, text))
        sys.stdout.flush()
        return
    try:
        write_whole(Path(target).expanduser(), text)
    except OSError as error:
        raise ConfigError(
            f"--json {target}: {error.strerror or error}", "a file that can be written"
        ) from error


def _encodable_json(encoding: str | None, text: str) -> str:
    """The JSON text, with characters escaped that the encoding cannot represent."""
    import json

    try:
        text.encode(encoding or "utf-8")
    except UnicodeEncodeError:
        return json.dumps(json.loads(text), indent=1) + "\n"
    return text


def _print_error(error: SpiralError, target: str | None) -> int:
    """Print an error on standard error, and write it as JSON where asked for; exit code 2."""
    print(f"spiral: bad input\n{error}", file=sys.stderr)
    if target is not None:
        try:
            _write_json({"error": error.as_dict()}, target)
        except SpiralError as other:
            print(other, file=sys.stderr)
    return BAD_INPUT


if __name__ == "__main__":
    entry()
