"""Recordings on disk: rosbag2 MCAP bags written and read, CSV logs imported, unfinished bags repaired.

Nothing outside `tms_bag.nodes` needs ROS at run time. Times at this border are integer nanoseconds, see
`tms_bag.samples` for units and frames.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tms_bag.arrays import recording_from_arrays
    from tms_bag.errors import RecordingError
    from tms_bag.reading.reader import BagReader, open_bag
    from tms_bag.record import Record
    from tms_bag.recording import Recording, read_recording
    from tms_bag.writing.writer import BagWriter

__version__ = "0.1.0"

__all__ = [
    "BagReader",
    "BagWriter",
    "Record",
    "Recording",
    "RecordingError",
    "open_bag",
    "read_recording",
    "recording_from_arrays",
]

# Loaded when they are asked for: the executables of the nodes must be up before half a second of imports.
_MODULES = {
    "BagReader": "reading.reader",
    "BagWriter": "writing.writer",
    "Record": "record",
    "Recording": "recording",
    "RecordingError": "errors",
    "open_bag": "reading.reader",
    "read_recording": "recording",
    "recording_from_arrays": "arrays",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
