"""Nodes that are to stay on this machine listen on this machine only.

With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST (or ROS_LOCALHOST_ONLY=1, its older form) rmw_fastrtps looks for
nobody elsewhere, and yet its sockets are open on every network: whoever names this machine in his
ROS_STATIC_PEERS is let in. A profile of Fast DDS that sets up the same on the loopback interface keeps him
out.
"""

from __future__ import annotations

from collections.abc import MutableMapping
from pathlib import Path

import rclpy

RANGE, PROFILES = "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE"
OLD_RANGE = "ROS_LOCALHOST_ONLY"  # still honoured, and then the range counts for nothing
LOOPBACK = Path(__file__).with_name("loopback.xml")
# Whoever has said how he wants it, by these or a file that Fast DDS reads in the working folder, gets that.
CHOSEN = (PROFILES, "FASTDDS_DEFAULT_PROFILES_FILE", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER")
OWN_PROFILES = "DEFAULT_FASTRTPS_PROFILES.xml"


def stay_on_this_machine(environment: MutableMapping[str, str]) -> None:
    """Where no other machine is to be reached, let Fast DDS listen on the loopback interface only.

    Changes the environment variables given; to be called before rclpy.init.
    """
    chosen = any(environment.get(name) for name in CHOSEN) or Path(OWN_PROFILES).exists()
    here_only = environment.get(RANGE) == "LOCALHOST" or environment.get(OLD_RANGE) == "1"
    if chosen or not here_only:
        return
    if rclpy.get_rmw_implementation_identifier().startswith("rmw_fastrtps"):
        # With LOCALHOST rmw_fastrtps would add its own sockets to those of the profile.
        environment.update({RANGE: "SYSTEM_DEFAULT", PROFILES: str(LOOPBACK)})
        environment.pop(OLD_RANGE, None)
