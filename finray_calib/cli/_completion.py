"""``finray completion``: a script by which bash or zsh completes commands, options and their choices."""

import argparse
from collections.abc import Iterator

from finray_calib.cli._output import give, say

HELP = "print the script by which bash or zsh completes what you type"
DESCRIPTION = """\
Print a script by which the shell completes commands, options and the choices of options when you press Tab; where a
file is wanted it completes files. Load it in the start file of your shell:

  bash   echo 'source <(finray completion bash)' >> ~/.bashrc
  zsh    echo 'source <(finray completion zsh)' >> ~/.zshrc"""
FOR_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"
SCRIPT = """\
_finray() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" command="" word words=""
  for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
    case "$command $word" in
      {commands}) command="$command $word" ;;
    esac
  done
  case "$command|$current" in
{options}
  esac
  case "$command $before" in
{choices}
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
complete -o default -F _finray finray
"""


def add_completion(verbs: "argparse._SubParsersAction[argparse.ArgumentParser]") -> None:
    """Register the verb."""
    parser = verbs.add_parser("completion", help=HELP, description=DESCRIPTION)
    parser.add_argument("shell", choices=["bash", "zsh"], help="your shell")
    parser.set_defaults(run=run_completion)


def run_completion(arguments: argparse.Namespace) -> None:
    """Print the script."""
    from finray_calib.cli.main import build_parser

    script = completion_script(build_parser(), arguments.shell)
    give(shell=arguments.shell, script=script)
    say(script.rstrip("\n"), fold=False)


def completion_script(parser: argparse.ArgumentParser, shell: str) -> str:
    """Return the script for a shell, "bash" or "zsh", of what a parser understands."""
    rooms = dict(_rooms(parser, ""))
    options, choices = [], []
    for command, room in rooms.items():
        known = room._actions  # noqa: SLF001 - argparse offers no other way to what it knows
        first = " ".join(str(word) for action in known if not action.option_strings for word in action.choices or ())
        flags = " ".join(flag for action in known for flag in action.option_strings if flag.startswith("--"))
        options += [f'    "{command}|-"*) words="{flags}" ;;', f'    "{command}|"*) words="{first}" ;;']
        for action in known:
            if action.option_strings and action.choices:
                chosen = " ".join(map(str, action.choices))
                choices += [f'    "{command} {flag}") words="{chosen}" ;;' for flag in action.option_strings]
    names = "|".join(f'"{command}"' for command in rooms if command)
    script = SCRIPT.format(commands=names, options="\n".join(options), choices="\n".join(choices))
    return FOR_ZSH + script if shell == "zsh" else script


def _rooms(parser: argparse.ArgumentParser, command: str) -> Iterator[tuple[str, argparse.ArgumentParser]]:
    """Yield each command, a blank before each of its words, with its parser; the first is empty."""
    yield command, parser
    for name, inner in _verbs(parser).items():
        yield from _rooms(inner, f"{command} {name}")


def _verbs(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return what a parser has below it."""
    below = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]  # noqa: SLF001
    return dict(below[0].choices) if below else {}
