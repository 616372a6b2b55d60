"""Command line of recordings as a module: python -m tms_bag."""

import sys

from tms_model.command_line import run
from tms_model.errors import ParameterError

from tms_bag.cli import main
from tms_bag.errors import RecordingError

if __name__ == "__main__":
    sys.exit(run(main, (RecordingError, ParameterError)))
