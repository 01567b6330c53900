"""The command `instok3d`: finds the subcommand, runs it, and turns errors into exit codes."""

import errno
import signal
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module

import tyro

from instok3d.cli.signals import EndedBySignal, orderly_end
from instok3d.cli.streams import keep_streams
from instok3d.errors import MissingWeightsError
from instok3d.version import generator

COMMANDS = {
    "demo": "reconstruct the photos that come with the package",
    "reconstruct": "photos in, a scene of objects out",
    "batch": "many scenes at once, from a folder of folders of photos",
    "refine": "a scene made sharper on its photos",
    "info": "what is in a scene",
    "objects": "the objects of a scene as data",
    "describe": "a scene in a few words, for people and language models",
    "diff": "what changed between two scenes of one room",
    "query": "objects of a scene by a text or a picture",
    "edit": "objects removed, moved, inserted, merged; undo and redo",
    "view": "a scene in the browser, to look at and to edit",
    "serve": "scenes for robots and assistants, over HTTP and MCP",
    "render": "pictures or a film of a scene",
    "export": "a scene as files that other programs open",
    "import": "a scene from a file of Gaussians",
    "push": "a scene to the Hugging Face hub",
    "library": "the objects of many scenes, found by text or image",
    "doctor": "what this machine has and lacks",
    "evaluate": "measure a model on rooms with known truth",
    "tables": "the paper's tables on rooms: trained, measured, written",
    "train": "train a model",
    "models": "weights made elsewhere: list, fetch, convert; models pushed to the hub",
    "data": "rooms, real data sets and masks to train on",
}
"""Each is the function `run` of `instok3d.cli.<name>`. Or that module has a table like this one, of
subcommands, and a function `subcommand` that imports one. An int that they return is the exit
code."""

ABOUT = "photos of a room in, a 3D scene made of objects out"

OUT_OF_MEMORY = ("can't allocate memory", "CUDA out of memory")
"""What torch, which has no error type for it on the CPU, says when memory runs out."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.ENOMEM, errno.EFBIG)

OK, BAD_INPUT, RESOURCES, MISSING_WEIGHTS = 0, 2, 3, 4


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; the result is the exit code.

    0 done, 2 bad input, 3 out of memory or disk, 4 no weights, 130 interrupted, 143 and 129 ended
    by SIGTERM and SIGHUP. Errors are one line on stderr; `--debug` shows where they came from.
    """
    keep_streams()
    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        with orderly_end():
            code = _dispatch(words)
        sys.stdout.flush()
        return code
    except KeyboardInterrupt as end:
        number = end.number if isinstance(end, EndedBySignal) else signal.SIGINT
        name = signal.Signals(number).name
        how = "interrupted" if number == signal.SIGINT else f"ended by {name}"
        print(f"\ninstok3d: {how}; nothing half-written was left", file=sys.stderr)
        return 128 + number
    except Exception as error:
        code = exit_code(error)
        if debug or code is None:
            traceback.print_exc()
        print(f"instok3d: {_sentence(error)}", file=sys.stderr)
        if code is None:
            print("instok3d: this is a fault in the program, please report it", file=sys.stderr)
        return 1 if code is None else code


def exit_code(error: Exception) -> int | None:
    """The exit code that an error stands for; None for those that only a fault can raise."""
    if isinstance(error, MissingWeightsError):
        return MISSING_WEIGHTS
    if isinstance(error, MemoryError) or any(text in str(error) for text in OUT_OF_MEMORY):
        return RESOURCES
    if isinstance(error, OSError) and error.errno in FULL:
        return RESOURCES
    if isinstance(error, ValueError | KeyError | OSError | ModuleNotFoundError):
        return BAD_INPUT
    return None


def _dispatch(words: list[str]) -> int:
    if words[:1] == ["--version"]:
        print(generator())
        return OK
    if not _names_one(words, COMMANDS):
        return _show_commands(words, "instok3d", ABOUT, COMMANDS)
    name, words = words[0], words[1:]
    module, program = import_module(f"instok3d.cli.{name}"), f"instok3d {name}"
    if not hasattr(module, "COMMANDS"):
        return _run(module.run, program, words)
    if not _names_one(words, module.COMMANDS):
        return _show_commands(words, program, COMMANDS[name], module.COMMANDS)
    return _run(module.subcommand(words[0]), f"{program} {words[0]}", words[1:])


def _names_one(words: list[str], commands: Mapping[str, str]) -> bool:
    return bool(words) and words[0] in commands


def _run(command: Callable[..., int | None], program: str, words: list[str]) -> int:
    try:
        code = tyro.cli(command, prog=program, args=words)
    except SystemExit as stop:  # tyro has printed its help or what is wrong with the arguments
        return stop.code if isinstance(stop.code, int) else OK if stop.code is None else BAD_INPUT
    return code if isinstance(code, int) else OK


def _show_commands(
    words: list[str], program: str, summary: str, commands: Mapping[str, str]
) -> int:
    """Print what the commands are, to whoever asked for help or named none of them."""
    if words and words[0] not in ("-h", "--help"):
        print(f"{program}: no command {words[0]!r}; the commands are: {', '.join(commands)}",
              file=sys.stderr)  # fmt: skip
        return BAD_INPUT
    width = max(map(len, commands))
    lines = [f"  {name:{width}}  {each}" for name, each in commands.items()]
    print(f"usage: {program} COMMAND ...", "", f"{summary[0].upper()}{summary[1:]}.", "", *lines,
          "", f"{program} COMMAND --help shows its options; --debug shows tracebacks.",
          sep="\n")  # fmt: skip
    return OK if words else BAD_INPUT


def _sentence(error: Exception) -> str:
    """The error in one line, with the name of the file where the system gave one."""
    if isinstance(error, KeyError) and error.args:
        return str(error.args[0])
    if isinstance(error, OSError) and error.strerror:
        place = f": {error.filename}" if error.filename else ""
        return f"{error.strerror}{place}"
    return " ".join(str(error).split()) or type(error).__name__
