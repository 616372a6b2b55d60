"""A node's services, answered in a thread of their own while its main thread keeps time."""

from __future__ import annotations

from threading import Thread

from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from tms_bag.nodes.process import RCLError


class Answering:
    """Spins a node from `start` until `stop`; answers that were begun are finished."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._executor = SingleThreadedExecutor(context=node.context)  # can't be made after a signal
        self._thread = Thread(target=self._spin, name="answers")

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread, if it has been started."""
        self._executor.shutdown()
        if self._thread.is_alive():
            self._thread.join()

    def _spin(self) -> None:
        try:
            self._executor.add_node(self._node)
            self._executor.spin()
        except ExternalShutdownException:
            pass
        except RCLError:
            if self._node.context.ok():  # else a signal came while a service or the report was at work
                raise
