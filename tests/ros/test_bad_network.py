"""Two network namespaces, UDP only, and a relay that loses 10 % of the frames and delays each by 200 ms."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from ament_index_python.packages import get_package_prefix
from tms_bag import BagReader, BagWriter, topics
from tms_fit.streaming.live_fit import INPUTS
from tms_sim.run import simulate
from tms_sim.scenario import load_scenario

LOSS, DELAY = 0.10, 0.200  # share of frames; [s] each way
PATIENCE = 300.0  # [s]
UDP_ONLY = """<?xml version="1.0" encoding="UTF-8" ?>
<profiles xmlns="http://www.eprosima.com">
  <transport_descriptors>
    <transport_descriptor><transport_id>udp</transport_id><type>UDPv4</type></transport_descriptor>
  </transport_descriptors>
  <participant profile_name="udp" is_default_profile="true">
    <rtps><userTransports><transport_id>udp</transport_id></userTransports>
      <useBuiltinTransports>false</useBuiltinTransports></rtps>
  </participant>
</profiles>
"""


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


class Network:
    """Two places that can hear each other through the relay only."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder, self.names = folder, [f"tms{os.getpid()}{side}" for side in "ab"]
        (folder / "udp.xml").write_text(UDP_ONLY)
        self.environment = os.environ | {
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET",
            "FASTRTPS_DEFAULT_PROFILES_FILE": str(folder / "udp.xml"),
        }
        self.processes: list[subprocess.Popen[bytes]] = []

    def make(self) -> None:
        outer = [f"t{os.getpid() % 100000}{side}" for side in "ab"]
        for number, (name, end) in enumerate(zip(self.names, outer, strict=True)):
            ip("netns", "add", name)
            ip("link", "add", end, "type", "veth", "peer", "name", "eth0", "netns", name)
            ip("link", "set", end, "up", "promisc", "on")
            inside = ["netns", "exec", name, "ip"]
            ip(*inside, "addr", "add", f"10.231.7.{number + 1}/24", "dev", "eth0")
            ip(*inside, "link", "set", "eth0", "up")
            ip(*inside, "link", "set", "lo", "up")
            ip(*inside, "route", "add", "224.0.0.0/4", "dev", "eth0")
        relay = [sys.executable, str(Path(__file__).with_name("relay.py")), *outer, str(LOSS), str(DELAY)]
        self.processes.append(subprocess.Popen([*relay, str(self.folder / "counts")]))

    def start(self, side: int, package: str, executable: str, *parameters: str) -> subprocess.Popen[bytes]:
        program = Path(get_package_prefix(package)) / "lib" / package / executable
        words = [word for parameter in parameters for word in ("-p", parameter)]
        command = [
            "ip",
            "netns",
            "exec",
            self.names[side],
            sys.executable,
            str(program),
            "--ros-args",
            *words,
        ]
        with (self.folder / f"{executable}.log").open("wb") as log:
            process = subprocess.Popen(
                command, env=self.environment, stdout=log, stderr=subprocess.STDOUT, cwd=self.folder
            )
        self.processes.append(process)
        return process

    def wait_for(self, executable: str, text: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while text not in (said := (self.folder / f"{executable}.log").read_text()):
            assert time.monotonic() < deadline, said
            time.sleep(0.1)

    def counts(self) -> tuple[int, int]:
        forwarded, dropped = (self.folder / "counts").read_text().split()
        return int(forwarded), int(dropped)

    def close(self) -> None:
        for process in self.processes:
            process.kill()
            process.wait()
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)


@pytest.fixture
def network(tmp_path: Path, domain_id: int) -> Iterator[Network]:
    if not shutil.which("ip"):
        pytest.skip("network namespaces need the command ip (iproute2)")
    network = Network(tmp_path, domain_id)
    try:
        network.make()
    except (subprocess.CalledProcessError, PermissionError) as error:
        network.close()
        pytest.skip(f"network namespaces can't be made here: {error}")
    yield network
    network.close()


def test_no_message_of_a_reliable_topic_is_lost(network: Network, tmp_path: Path) -> None:
    run = simulate(load_scenario("tms_strike", {"seed": 11}), np.random.default_rng(11))
    records = [record for record in run.records() if record.topic.removeprefix("/") in INPUTS]
    with BagWriter(tmp_path / "bag") as bag:
        for record in records:
            bag.write(record, topics.QOS[record.topic.removeprefix("/")])
    chosen = sorted({record.topic for record in records})
    recorder = network.start(
        1, "tms_bag", "recorder", f"output:={tmp_path / 'copy'}", f"topics:=[{','.join(chosen)}]"
    )
    network.wait_for("recorder", "recording to")
    player = network.start(
        *(0, "tms_bag", "player", f"bag:={json.dumps(str(tmp_path / 'bag'))}"),
        *(f"wait_for_subscriptions:={len(chosen)}", f"wait_timeout:={PATIENCE}"),
    )
    assert player.wait(2 * PATIENCE) == 0, (tmp_path / "player.log").read_text()
    deadline = time.monotonic() + PATIENCE

    def arrived() -> dict[str, list[bytes]]:
        found: dict[str, list[bytes]] = {topic: [] for topic in chosen}
        with BagReader(tmp_path / "copy") as reader:
            for record in reader.records():
                found[record.topic].append(record.data)
        return found

    while sum(map(len, arrived().values())) < len(records) and time.monotonic() < deadline:
        time.sleep(0.5)
    recorder.send_signal(2)
    assert recorder.wait(PATIENCE) == 0
    sent = {topic: [r.data for r in records if r.topic == topic] for topic in chosen}
    said = "".join((tmp_path / f"{name}.log").read_text() for name in ("player", "recorder"))
    came = arrived()
    missing = {
        topic: [n for n, data in enumerate(sent[topic]) if data not in came[topic]] for topic in chosen
    }
    assert not any(missing.values()), f"{missing}\n{said}"
    assert came == sent, said
    with BagReader(tmp_path / "copy") as reader:
        assert reader.custom_data["lost"] == "{}"
    forwarded, dropped = network.counts()
    assert dropped > 50
    assert dropped / (forwarded + dropped) == pytest.approx(LOSS, abs=0.04)
