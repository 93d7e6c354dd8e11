"""The commands. Results on stdout, progress on stderr; the work is in the rooms below.

Exit codes: 0 done, 1 something the user can mend, 2 usage, 3 done but no axis beats the Workbench.
"""

from __future__ import annotations

import click

from ftcal import __version__
from ftcal.cli.calibrating import calibrate, fleet, study, validate
from ftcal.cli.deploying import apply, diff, export
from ftcal.cli.frame import WIDTH
from ftcal.cli.looking import inspect
from ftcal.cli.pretending import demo, simulate
from ftcal.cli.weighing import payload

__all__ = ["main"]


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": WIDTH})
@click.version_option(__version__, prog_name="ftcal")
def main() -> None:
    """Calibrate the six-axis force/torque sensors inside a robot, where they sit.

    The robot moves, its model says what each sensor should have felt, a regression towards the
    manufacturer's Workbench matrix finds the sensor that would have said so, and recordings it
    never saw judge it.
    """


for command in (
    inspect,
    calibrate,
    study,
    validate,
    fleet,
    apply,
    export,
    diff,
    payload,
    simulate,
    demo,
):
    main.add_command(command)
