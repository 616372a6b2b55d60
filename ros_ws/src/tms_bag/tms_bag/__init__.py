"""Recordings on disk: rosbag2 MCAP bags written and read, CSV logs imported, unfinished bags repaired.

Nothing outside `tms_bag.nodes` needs ROS at run time. Times at this border are integer nanoseconds, see
`tms_bag.samples` for units and frames.
"""

from tms_bag.errors import RecordingError
from tms_bag.reading.reader import BagReader
from tms_bag.record import Record
from tms_bag.recording import Recording, read_recording
from tms_bag.writing.writer import BagWriter

__version__ = "0.1.0"

__all__ = ["BagReader", "BagWriter", "Record", "Recording", "RecordingError", "read_recording"]
