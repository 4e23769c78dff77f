"""The command line: parse, call, print. One file a command."""

from collections.abc import Callable

from panopath.cli.app import EXIT_HELP, app, main
from panopath.cli.check import check
from panopath.cli.demo import demo
from panopath.cli.demo_bearings import demo_bearings
from panopath.cli.doctor import doctor_command
from panopath.cli.evaluate import evaluate_command
from panopath.cli.map import map_command
from panopath.cli.paper import paper_command
from panopath.cli.reconstruct import reconstruct_command
from panopath.cli.simulate import simulate_command
from panopath.cli.solve import solve
from panopath.cli.view import view_command

__all__ = ["app", "main"]

#: In the order in which the help lists them.
_COMMANDS: dict[str, Callable[..., None]] = {
    "reconstruct": reconstruct_command,
    "solve": solve,
    "map": map_command,
    "check": check,
    "simulate": simulate_command,
    "evaluate": evaluate_command,
    "demo": demo,
    "demo-bearings": demo_bearings,
    "view": view_command,
    "paper": paper_command,
    "doctor": doctor_command,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, epilog=EXIT_HELP)(_command)
