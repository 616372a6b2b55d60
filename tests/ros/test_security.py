"""Who asks for a secured network, or another one than this machine, gets what was asked for or a clear no."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
from tms_bag.nodes.security import dds_has_security, security_asked_for

NODES = {"recorder": "tms_bag", "player": "tms_bag", "simulator": "tms_sim", "estimator": "tms_fit"}
SOURCES = Path(__file__).parents[2] / "ros_ws" / "src"
SERVERS = {"socket", "socketserver", "http", "xmlrpc", "asyncio", "websockets", "aiohttp", "foxglove"}


@pytest.mark.skipif(dds_has_security(), reason="this DDS can be secured: nodes start in their enclave")
@pytest.mark.parametrize("name", NODES)
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


def test_nothing_but_dds_listens_on_a_network() -> None:
    # A server that is added must listen on this machine only: then say here how that is tested.
    found = set()
    for path in SOURCES.glob("tms_*/tms_*/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            found |= {(path.name, name) for name in names if name.partition(".")[0] in SERVERS}
    assert found == set()
