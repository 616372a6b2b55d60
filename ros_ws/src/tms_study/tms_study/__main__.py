"""Command line of the studies as a module: python -m tms_study."""

import sys

from tms_bag.errors import RecordingError
from tms_model.command_line import run
from tms_model.errors import ParameterError

from tms_study.cli import main

if __name__ == "__main__":
    sys.exit(run(main, (ParameterError, RecordingError)))
