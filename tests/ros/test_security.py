"""Who asks for a secured network, or another one than this machine, gets what was asked for or a clear no."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from tms_bag.nodes.loopback import LOOPBACK, stay_on_this_machine
from tms_bag.nodes.security import dds_has_security, security_asked_for

NODES = {"recorder": "tms_bag", "player": "tms_bag", "simulator": "tms_sim", "estimator": "tms_fit"}
SOURCES = Path(__file__).parents[2] / "ros_ws" / "src"
SERVERS = {"socket", "socketserver", "http", "xmlrpc", "asyncio", "websockets", "aiohttp", "foxglove"}


@pytest.mark.skipif(dds_has_security(), reason="this DDS can be secured: nodes start in their enclave")
@pytest.mark.parametrize("name", NODES)
@pytest.mark.quick_for(name=["recorder"])
def test_no_node_starts_where_its_enclave_would_mean_nothing(name: str) -> None:
    ways = {
        "--enclave": (["--enclave", "/tms/node"], {}),
        "ROS_SECURITY_ENABLE": ([], {"ROS_SECURITY_ENABLE": "true"}),
        "ROS_SECURITY_ENCLAVE_OVERRIDE": ([], {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/tms/node"}),
    }
    for asked, (arguments, environment) in ways.items():
        command = [sys.executable, "-m", f"{NODES[name]}.nodes.{name}", "--ros-args", *arguments]
        found = subprocess.run(
            command, env=os.environ | environment, capture_output=True, text=True, timeout=120.0, check=False
        )
        assert found.returncode == 2, found.stderr
        (line,) = found.stderr.splitlines()
        assert line.startswith(f"error: {asked}")
        assert "built without security" in line
        assert found.stdout == ""


@pytest.mark.parametrize(
    ("arguments", "environment", "asked"),
    [
        ([], {}, ""),
        (["--ros-args", "-p", "output:=x"], {"ROS_SECURITY_KEYSTORE": "/keys"}, ""),
        ([], {"ROS_SECURITY_ENABLE": "false"}, ""),
        (["--ros-args", "-e", "/tms"], {}, "--enclave"),
        (["--ros-args", "--enclave", "/tms"], {"ROS_SECURITY_ENABLE": "true"}, "ROS_SECURITY_ENABLE=true"),
    ],
)
def test_what_asks_for_security(arguments: list[str], environment: dict[str, str], asked: str) -> None:
    assert security_asked_for(arguments, environment) == asked


@pytest.mark.parametrize("name", NODES)
@pytest.mark.quick_for(name=["estimator"])
def test_every_socket_of_a_node_is_on_the_loopback(
    nodes: Any, participant: Any, name: str, bag: Path
) -> None:
    arguments = {
        "player": ["-p", f"bag:={bag}", "-p", "start_paused:=true"],
        "simulator": ["-p", "autostart:=false"],
    }
    node = nodes.start(NODES[name], name, *arguments.get(name, []))
    participant.reach(f"/{name}")
    assert sockets(node.pid) == {"127.0.0.1"}
    nodes.stop(node)


def sockets(process: int) -> set[str]:
    """Local addresses of a process's sockets over UDP and TCP."""
    own = set()
    for one in Path(f"/proc/{process}/fd").iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            own.add(str(one.readlink()))
    found = set()
    for table in ("udp", "udp6", "tcp", "tcp6"):
        for line in Path(f"/proc/{process}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if f"socket:[{fields[9]}]" in own:
                address = bytes.fromhex(fields[1].partition(":")[0])
                found.add(".".join(str(byte) for byte in reversed(address)))
    return found


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, ("SYSTEM_DEFAULT", str(LOOPBACK))),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, ("SUBNET", None)),
        ({}, (None, None)),
        ({"ROS_LOCALHOST_ONLY": "1"}, ("SYSTEM_DEFAULT", str(LOOPBACK))),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "10.0.0.2"}, ("LOCALHOST", None)),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "FASTRTPS_DEFAULT_PROFILES_FILE": "mine.xml"},
            ("LOCALHOST", "mine.xml"),
        ),
    ],
)
def test_who_says_how_far_to_reach_gets_that(
    environment: dict[str, str], expected: tuple[str | None, str | None]
) -> None:
    stay_on_this_machine(environment)
    found = (
        environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE"),
        environment.get("FASTRTPS_DEFAULT_PROFILES_FILE"),
    )
    assert found == expected


def test_nothing_but_dds_listens_on_a_network() -> None:
    # A server that is added must listen on this machine only: then say here how that is tested.
    found = set()
    for path in SOURCES.glob("tms_*/tms_*/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found |= {(path.name, name) for name in names if name.partition(".")[0] in SERVERS}
    assert found == set()
