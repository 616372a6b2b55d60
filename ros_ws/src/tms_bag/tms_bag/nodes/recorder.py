"""Recorder: finds topics and their types by itself and writes their messages, as they come, into a bag."""

from __future__ import annotations

import sys
import time
from contextlib import suppress
from functools import partial
from typing import Any

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

import tms_bag
from tms_bag.nodes.discovery import Discovery
from tms_bag.nodes.process import RCLError, run_node
from tms_bag.nodes.recorder_report import RecorderReport
from tms_bag.nodes.recorder_services import offer_services
from tms_bag.nodes.recorder_settings import declare_recorder_settings
from tms_bag.nodes.stamping import WallStamps, make_stamps
from tms_bag.record import Record
from tms_bag.remarks import closing_words, disk_told, recording_remarks
from tms_bag.writing.live_bag import LiveBag
from tms_bag.writing.recent import RecentRecords
from tms_bag.writing.writer import BagWriter

LOOK_PERIOD = 0.1  # [s] how soon a new topic is found
DRAIN_PERIOD = 0.005  # [s]


class Recorder(Node):
    """Node that writes a bag until it is stopped."""

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", **kwargs)
        settings = declare_recorder_settings(self)
        self._stamps = make_stamps(self)
        self._writer = BagWriter(
            settings.output, live=True, preset=settings.compression, splitting=settings.splitting
        )
        recent = RecentRecords(settings.snapshot, settings.snapshot_memory) if settings.snapshot else None
        self._bag = LiveBag(self._writer, recent, settings.start_paused)
        self._discovery = Discovery(
            *(self, settings.selection, settings.history, settings.include_unpublished),
            announce=self._writer.add_channel,
        )
        self._stopped = False
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self)
        offer_services(self, self._bag, self._drain_all, self._stop)
        RecorderReport(self, self._bag, self._discovery, self._stamps)
        self.get_logger().info(f"recording to {self._writer.path}")

    def run(self) -> None:
        """Record until ~/stop or a signal. OSError when the disk takes no more."""
        look_at = 0.0
        with disk_told(self._writer.path):
            while not self._stopped:
                if time.monotonic() >= look_at:
                    self._discovery.look()
                    look_at = time.monotonic() + LOOK_PERIOD
                self._executor.spin_once(timeout_sec=DRAIN_PERIOD)
                self._drain_all()
                self._bag.flush_when_due()

    def close(self) -> None:
        """Take what has arrived, close the bag and say what is in it. OSError when the disk takes no more."""
        found = self._discovery
        with disk_told(self._writer.path):
            try:
                if not self._stamps.ready:
                    self._stamps = WallStamps()
                    print("/clock has not ticked: messages are stamped with the wall's time", file=sys.stderr)
                with suppress(RCLError):
                    self._drain_all()
            finally:
                self._writer.custom_data = recording_remarks(
                    *(f"tms_bag {tms_bag.__version__}", self._stamps.name, found.lost, found.sent_before),
                    *(found.passed_over, self._bag.left_out),
                )
                self._bag.close()
        words = closing_words(self._writer.counts, found.lost, found.passed_over)
        print(f"{self._writer.path}: {words}", file=sys.stderr)

    def _stop(self) -> None:
        self._stopped = True

    def _drain_all(self) -> None:
        while self._drain():
            pass

    def _drain(self) -> bool:
        """Take what has arrived, in turn; returns whether more may be waiting."""
        self._stamps.follow()
        if not self._stamps.ready:
            return False
        more = [
            intake.drain(partial(self._take, name, self._discovery.type_of(name)))
            for name, intake in self._discovery.intakes.items()
        ]
        return any(more)

    def _take(self, name: str, kind: str, data: bytes, arrived_ns: int, sent_ns: int) -> None:
        stamp = self._stamps.at(arrived_ns)
        sent = sent_ns if stamp == arrived_ns else stamp
        self._bag.take(Record(name, kind, stamp, data, sent), arrived_ns)


def main(args: list[str] | None = None) -> int:
    """Run the recorder as a process."""
    return run_node(Recorder, args)


if __name__ == "__main__":
    sys.exit(main())
