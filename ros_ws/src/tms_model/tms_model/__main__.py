"""Command line of the bicycle model as a module: python -m tms_model."""

import sys

from tms_model.cli import main
from tms_model.command_line import run
from tms_model.errors import ParameterError

if __name__ == "__main__":
    sys.exit(run(main, (ParameterError,)))
