"""`treadlight <command>`: finds the command's module, turns errors into one plain sentence."""

import argparse
import importlib
import os
import sys

import treadlight
from treadlight.commands.names import COMMANDS
from treadlight.errors import ConfigError, sentence_of
from treadlight.memory import require_address_space
from treadlight.threads import use_cores


def main(argv: list[str] | None = None) -> int:
    """Run one command; returns the exit status: 1 for what failed, 2 for wrong use."""
    argv = sys.argv[1:] if argv is None else argv
    try:
        return _run(argv)
    except Exception as error:
        command = argv[0] if argv else ""
        print(f"treadlight {command}: {sentence_of(error)}", file=sys.stderr)
        return 2 if isinstance(error, ConfigError) else 1


def _run(argv: list[str]) -> int:
    # Before a command's module loads numpy: sums by several threads depend on their number.
    os.environ["OPENBLAS_NUM_THREADS"] = "1"
    name = argv[0] if argv and argv[0] in COMMANDS else None
    options = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    _add_threads(options)
    threads = options.parse_known_args(argv)[0].threads
    require_address_space(threads)
    os.environ["OMP_NUM_THREADS"] = str(threads)
    use_cores(threads)
    parser = argparse.ArgumentParser(prog="treadlight", description=treadlight.__doc__)
    parser.add_argument("--version", action="version", version=treadlight.__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="command")
    # Only the wanted command is imported: --help and short commands stay fast.
    for command in [name] if name else COMMANDS:
        module = importlib.import_module(f"treadlight.commands.{COMMANDS[command]}")
        summary = (module.__doc__ or "").strip().splitlines()[0]
        sub = commands.add_parser(command, help=summary, description=module.__doc__)
        _add_threads(sub)
        module.add_arguments(sub)
        sub.set_defaults(run=module.run)
    args = parser.parse_args(argv)
    return int(args.run(args) or 0)


def _add_threads(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--threads", type=int, default=os.cpu_count(), help="cores to use")


if __name__ == "__main__":
    sys.exit(main())
