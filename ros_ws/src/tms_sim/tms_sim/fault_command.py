"""`sim fault BAG`: a recording with faults put into it, each told as an event."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tms_model.command_line import print_json
from tms_model.errors import ParameterError

if TYPE_CHECKING:
    from tms_bag.event import Event

    from tms_sim.fault_injection import Request


def fault_arguments(parser: argparse.ArgumentParser) -> None:
    """What `sim fault` takes."""
    parser.add_argument("bag", nargs="?", help="bag to read")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="NAME[:KEY=VALUE,...]",
        help="fault to put in, e.g. stuck:time=3,duration=0.5; repeat for more; keys: time and duration [s],"
        " topic, and what --list shows",
    )
    parser.add_argument("-o", "--output", help="bag folder to make")
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of what is random in the faults (default: 1)"
    )
    parser.add_argument("--force", action="store_true", help="replace the bag if it exists")
    parser.add_argument("--list", action="store_true", help="list the faults and their settings")
    parser.add_argument("--json", action="store_true", help="one JSON document on stdout")


def fault(arguments: argparse.Namespace) -> None:
    """Answer `sim fault`. Raises ParameterError and RecordingError."""
    if arguments.list:
        _list(arguments.json)
        return
    if not arguments.bag or not arguments.output or not arguments.fault:
        raise ParameterError("expected BAG --fault NAME -o NEW_BAG, or --list")
    if arguments.seed < 0:
        raise ParameterError(f"--seed: expected a whole number from 0 on, found {arguments.seed}")
    if Path(arguments.output).resolve() == Path(arguments.bag).resolve():
        raise ParameterError(
            f"--output: expected another bag than the one that is read, found {arguments.output}"
        )
    from tms_sim.fault_injection import parse_request

    requests = [parse_request(asked) for asked in arguments.fault]
    told = spoil_bag(
        arguments.bag, requests, arguments.output, arguments.seed, "; ".join(arguments.fault), arguments.force
    )
    if arguments.json:
        keys = ("kind", "time_ns", "text", "duration")
        print_json(
            {"path": arguments.output, "events": [{key: getattr(e, key) for key in keys} for e in told]}
        )
        return
    for event in told:
        print(event.text)


def spoil_bag(
    source: str, requests: list[Request], target: str, seed: int, asked: str, overwrite: bool = False
) -> list[Event]:
    """Write the bag `target`: messages of `source` with faults, and their events. Raises RecordingError."""
    import numpy as np
    from tms_bag import BagReader, BagWriter, topics
    from tms_bag.event import event_records
    from tms_bag.record import merged

    from tms_sim.fault_injection import inject
    from tms_sim.truth import true_events

    with BagReader(source) as bag:
        channels, custom_data, start_ns = bag.channels, bag.custom_data, bag.start_ns
        records, found = inject(bag.records(), requests, start_ns, np.random.default_rng(seed))
    told = list(true_events(found, start_ns))
    made = {"faults": asked, "faults_seed": str(seed)}  # after those that the recording has already
    made = {key: "; ".join(filter(None, (custom_data.get(key), value))) for key, value in made.items()}
    with BagWriter(target, custom_data={**custom_data, **made}, overwrite=overwrite) as written:
        for channel in channels:
            written.add_channel(channel)
        for record in merged(event_records(told), records):
            written.write(record, topics.QOS[topics.EVENTS])
    return told


def _list(as_json: bool) -> None:
    from tms_sim.faults import FAULTS

    if as_json:
        print_json(
            {
                "faults": [
                    {"name": name, "text": one.text, "topics": list(one.topics), "settings": one.defaults}
                    for name, one in FAULTS.items()
                ]
            }
        )
        return
    for name, one in FAULTS.items():
        settings = ", ".join(f"{key}={value:g}" if isinstance(value, float) else f"{key}={value}"
                             for key, value in one.defaults.items())  # fmt: skip
        print(f"{name:13} {one.text} ({settings})")
