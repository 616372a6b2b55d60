"""Command line of the simulator as a module: python -m tms_sim."""

import sys

from tms_bag.errors import RecordingError
from tms_model.command_line import run
from tms_model.errors import ParameterError

from tms_sim.cli import main

if __name__ == "__main__":
    sys.exit(run(main, (ParameterError, RecordingError)))
