"""The command line, `delfim COMMAND ...`: finds the command, runs it and reports its failure.

A failure that the user can put right is one line on standard error, with exit code 2.
"""

import argparse
import re
import select
import sys
from collections.abc import Sequence
from types import ModuleType

from delfim import __version__
from delfim.base.errors import DelfimError, PermanentFailure, Refused, did_you_mean, in_words
from delfim.commands import GROUPS, LINUX, SENTENCES, Formatter, loaded

EXIT_REFUSED, EXIT_WRONG, EXIT_PERMANENT = 1, 2, 100  # 100 tells the supervisor: do not start me again
SOUTHERN = re.compile(r"-[0-9.]+,.*")
FORMATS = ("asammdf", "pyarrow", "scipy")  # packages of delfim[formats]; all others are of delfim[ground]


def main(arguments: Sequence[str] | None = None) -> int:
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(listing())
        return 0
    if words[0] == "--version":
        print(f"delfim {__version__}")
        return 0
    try:
        if words[0] in LINUX and not hasattr(select, "epoll"):
            raise DelfimError(
                f"{words[0]} needs Linux, as the boat's computer has it; sim --lockstep, console and log run here, too"
            )
        command, asked = parsed(words)
        code: int = command.run(asked)
        return code
    except KeyboardInterrupt:
        return 130
    except EOFError:  # a question, and nobody to answer it
        print(f"delfim: {words[0]}: the answers ended too early", file=sys.stderr)
        return EXIT_WRONG
    except BrokenPipeError:  # `delfim ... | head`
        return 0
    except Refused as refusal:
        print(f"delfim: {refusal}", file=sys.stderr)
        return EXIT_REFUSED
    except PermanentFailure as failure:
        print(f"delfim: {failure}", file=sys.stderr)
        return EXIT_PERMANENT
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in ("", "delfim"):  # a defect
            raise
        if package in sys.stdlib_module_names:  # the computer is none that a boat has
            print(f"delfim: {words[0]} needs Linux: this system has no {package}", file=sys.stderr)
            return EXIT_WRONG
        extra = "campaign" if words[0] == "campaign" else "formats" if package in FORMATS else "ground"
        print(f"delfim: {words[0]} needs {package}, which is not installed: pip install 'delfim[{extra}]'", file=sys.stderr)
        return EXIT_WRONG
    except (DelfimError, OSError) as error:  # the latter: no permission, no such folder, a full disk
        print(f"delfim: {in_words(error)}", file=sys.stderr)
        return EXIT_WRONG


def listing() -> str:
    """All commands, by task."""
    lines = ["usage: delfim COMMAND ...", "", "The onboard software of an autonomous surface vehicle."]
    for group, commands in GROUPS.items():
        lines += ["", f"{group}:", *(f"  {name:10} {sentence}" for name, sentence in commands.items())]
    return "\n".join([*lines, "", "delfim COMMAND --help lists the options of a command, delfim --version prints the version."])


def parsed(words: Sequence[str]) -> tuple[ModuleType, argparse.Namespace]:
    """The command and its options. Raises DelfimError for an unknown command, SystemExit for wrong options."""
    name, *rest = words
    command, parser = declared(name)
    asked, more = parser.parse_known_args(_joined(rest))
    unknown = [word for word in more if word.startswith("-") and not word[1:2].isdigit()]
    if unknown or (more and "many" not in asked):
        parser.error(f"unrecognized arguments: {' '.join(unknown or more)}")
    if more:  # argparse finds the words of a list behind its options only where no option stands before them
        getattr(asked, asked.many).extend(more)
    return command, asked


def _joined(words: Sequence[str]) -> list[str]:
    """The words, a place of the southern half behind `--at` hung on it: argparse takes `-33.85,151.2` for another option."""
    joined = list[str]()
    for word in words:
        if SOUTHERN.fullmatch(word) and joined[-1:] == ["--at"]:
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def declared(name: str) -> tuple[ModuleType, argparse.ArgumentParser]:
    """A command and the parser of its options. Raises DelfimError for an unknown command."""
    if name not in SENTENCES:
        raise DelfimError(f"there is no command {name!r}{did_you_mean(name, SENTENCES)}; delfim alone lists all")
    command = loaded(name)
    parser = argparse.ArgumentParser(prog=f"delfim {name}", description=SENTENCES[name], formatter_class=Formatter)
    command.options(parser)
    return command, parser


if __name__ == "__main__":
    sys.exit(main())
